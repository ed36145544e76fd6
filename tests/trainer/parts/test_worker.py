"""A stream in parts, without a cluster: the pieces fit, for any number of worker deaths."""

from __future__ import annotations

import os
import random
import shutil
import signal
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pytest

from codec.stream import StreamReader
from codec.stream.seeker import roll
from codec.tools.audit import verify_stream
from tests.support.parts import (
    FRAMES,
    DiedError,
    capture_of,
    contents,
    do_here,
    run_of,
    train,
)
from tests.support.stores.s3_server import BUCKET, s3_server
from trainer.parts.joiner import Joiner
from trainer.parts.task import STATE_FOLDER, Kind, Task


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return capture_of(tmp_path_factory.mktemp("parts"))


@pytest.fixture(scope="module")
def stream(capture: Path) -> Path:
    path = capture.parent / "stream"
    train(run_of(capture, path), do_here)
    return path


def test_parts_make_one_valid_stream(capture: Path, stream: Path) -> None:
    audit = verify_stream(stream)
    assert (audit.num_frames, audit.live) == (FRAMES, False)
    assert not (stream / STATE_FOLDER).exists()
    run = run_of(capture, stream.parent / "other")
    assert [part.end_frame for part in run.parts] == [8, 16, 22]


def test_to_join_anywhere_is_to_have_played_from_the_beginning(stream: Path) -> None:
    reader = StreamReader(stream)
    manifest, layers = reader.manifest, reader.manifest.num_layers
    playing = reader.decoder_at(0, layers)
    for frame in range(FRAMES):
        roll(reader.read_object, manifest, frame, playing)
        joined, played = reader.decoder_at(frame, layers).whole(frame), playing.whole(frame)
        for one, other in zip(joined.splats.arrays, played.splats.arrays, strict=True):
            assert np.array_equal(one, other)
        assert np.array_equal(joined.start_offsets, played.start_offsets)


@pytest.mark.parametrize("keep_s", [0.0, 60.0])
def test_workers_that_die_leave_the_same_stream(
    capture: Path, stream: Path, tmp_path: Path, keep_s: float
) -> None:
    """The test runs with a checkpoint at every possible moment, and without any."""
    rng = random.Random(3)
    left = 20

    def die(iterations: int) -> None:
        nonlocal left
        if left and rng.random() < 0.5:
            left -= 1
            raise DiedError

    path = tmp_path / "stream"
    train(run_of(capture, path), partial(do_here, report=die, keep_s=keep_s))
    assert left == 0
    assert contents(path) == contents(stream)


def test_a_driver_that_died_at_any_moment_is_gone_on_from(
    capture: Path, stream: Path, tmp_path: Path
) -> None:
    whole = tmp_path / "whole"
    run = run_of(capture, whole)
    for task in run.tasks:
        do_here(task)
        if task.kind is Kind.GENESIS:
            Joiner(run).begin(resumed=False)
    for num_bytes in range(0, len((stream / "index.bin").read_bytes()) + 1, 200):
        shutil.copytree(whole, path := tmp_path / "died")
        (path / "index.bin").write_bytes((stream / "index.bin").read_bytes()[:num_bytes])
        joiner = Joiner(run_of(capture, path))
        found = joiner.begin(resumed=True)
        new = [record for _, records in joiner.go_on() for record in records]
        assert [record.first_frame for record in found + new] == [*range(0, FRAMES, 2)]
        joiner.finish()
        assert contents(path) == contents(stream)
        shutil.rmtree(path)


def test_from_store_to_store_are_the_bytes_of_folders(capture: Path, stream: Path) -> None:
    with s3_server() as server:
        server.upload(capture, "captures/one")
        url = f"s3://{BUCKET}/streams/one"
        train(run_of(f"s3://{BUCKET}/captures/one", url), do_here)
        assert server.files("streams/one") == contents(stream)
        assert not verify_stream(url).live


def do_until_killed(task: Task, iterations: int) -> None:
    """Executes a task in this process, which is ended by SIGKILL after `iterations`."""

    def kill(done: int) -> None:
        if done >= iterations:
            os.kill(os.getpid(), signal.SIGKILL)

    do_here(task, kill, keep_s=0.0)


WARM, IN_SEAM = 20, 40
"""Iterations of a window, and of a window in a seam."""


@pytest.mark.parametrize(
    ("name", "killed_at", "resumed_at"),
    [
        ("genesis", 40, 20),
        ("genesis", 60, 40),  # in a settle round
        ("part-0", 5 * WARM, 4 * WARM),  # in a segment
        ("part-1", 2 * WARM, 1 * WARM),  # in the warm-up
        ("part-1", 2 * WARM + 3 * IN_SEAM, 2 * WARM + 2 * IN_SEAM),  # in the approach
        ("seam-1", 2 * IN_SEAM, 1 * IN_SEAM),  # in a segment
        ("seam-2", 3 * IN_SEAM, 2 * IN_SEAM),  # after a segment
    ],
)
def test_a_killed_task_goes_on_from_its_checkpoint(
    capture: Path, stream: Path, tmp_path: Path, name: str, killed_at: int, resumed_at: int
) -> None:
    done = list[int]()

    def do(task: Task) -> None:
        if task.name != name:
            return do_here(task)
        process = get_context("spawn").Process(target=do_until_killed, args=(task, killed_at))
        process.start()
        process.join()
        assert process.exitcode == -signal.SIGKILL
        do_here(task, done.append)
        assert done[-1] == task.iterations

    path = tmp_path / "stream"
    train(run_of(capture, path), do)
    assert done[0] == resumed_at
    assert contents(path) == contents(stream)
