"""A stream in parts, without a cluster: the pieces fit, however often a worker dies."""

from __future__ import annotations

import json
import random
import shutil
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from codec.storage.openfiles import FilesFolder, open_files
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
    tasks_of,
    train,
)
from tests.support.stores.s3_server import BUCKET, s3_server
from trainer.parts.joiner import Joiner
from trainer.parts.task import STATE_FOLDER, Kind


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return capture_of(tmp_path_factory.mktemp("parts"))


@pytest.fixture(scope="module")
def stream(capture: Path) -> Path:
    path = capture.parent / "stream"
    train(run_of(capture, path), FilesFolder(path), do_here)
    return path


def test_parts_make_one_valid_stream(capture: Path, stream: Path) -> None:
    audit = verify_stream(stream)
    assert (audit.num_frames, audit.live) == (FRAMES, False)
    assert not (stream / STATE_FOLDER).exists()
    assert json.loads((stream / "manifest.json").read_bytes())["live"] is False
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


def test_workers_that_die_leave_the_same_stream(
    capture: Path, stream: Path, tmp_path: Path
) -> None:
    rng = random.Random(3)
    left = 20

    def die(iterations: int) -> None:
        nonlocal left
        if left and rng.random() < 0.5:
            left -= 1
            raise DiedError

    path = tmp_path / "stream"
    train(run_of(capture, path), FilesFolder(path), partial(do_here, tell=die))
    assert left == 0
    assert contents(path) == contents(stream)


def test_a_driver_that_died_at_any_moment_is_gone_on_from(
    capture: Path, stream: Path, tmp_path: Path
) -> None:
    whole = tmp_path / "whole"
    run = run_of(capture, whole)
    for task in tasks_of(run):
        do_here(task)
        if task.kind is Kind.GENESIS:
            Joiner(run, FilesFolder(whole)).begin(resumed=False)
    for num_bytes in range(0, len((stream / "index.bin").read_bytes()) + 1, 200):
        shutil.copytree(whole, path := tmp_path / "died")
        (path / "index.bin").write_bytes((stream / "index.bin").read_bytes()[:num_bytes])
        joiner = Joiner(run_of(capture, path), FilesFolder(path))
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
        train(run_of(f"s3://{BUCKET}/captures/one", url), open_files(url), do_here)
        assert server.files("streams/one") == contents(stream)
        assert not verify_stream(url).live
