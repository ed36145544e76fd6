"""A stream in parts, without a cluster: the pieces fit, for any number of worker deaths."""

from __future__ import annotations

import random
import shutil
from collections import defaultdict
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from codec.stream import StreamReader
from codec.stream.reader import roll
from codec.tools.audit import verify_stream
from tests.support.parts import FRAMES, DiedError, capture_of, do_here, run_of, train
from tests.support.stores.s3_server import BUCKET, s3_server
from tests.support.suite.once import made_once
from tests.support.trainings import contents
from trainer.parts.joiner import Joiner
from trainer.parts.task import STATE_FOLDER, Kind, Task


@pytest.fixture(scope="module", autouse=True)
def trades() -> Iterator[None]:
    """Some Gaussians of so few change their layers."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("trainer.lease.leases.TRADE_SHARE", 0.05)
        yield


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return capture_of(tmp_path_factory)


@pytest.fixture(scope="module")
def trained(capture: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the stream, and with `pieces`: all that workers left before they were joined,
    in a stream whose driver died after genesis."""

    def make(folder: Path) -> None:
        run = run_of(capture, folder / "pieces")
        for task in run.tasks:
            do_here(task)
            if task.kind is Kind.GENESIS:
                Joiner(run).begin(resumed=False)
        shutil.copytree(folder / "pieces", folder / "stream")
        joiner = Joiner(run_of(capture, folder / "stream"))
        joiner.begin(resumed=False)
        assert len(list(joiner.go_on())) == len(run.tasks) - 1
        joiner.finish()

    return made_once(tmp_path_factory, "parts", make)


@pytest.fixture(scope="module")
def stream(trained: Path) -> Path:
    return trained / "stream"


def test_parts_make_one_valid_stream(capture: Path, stream: Path) -> None:
    audit = verify_stream(stream)
    assert (audit.num_frames, audit.live) == (FRAMES, False)
    assert not (stream / STATE_FOLDER).exists()
    run = run_of(capture, stream.parent / "other")
    assert [part.end_frame for part in run.parts] == [8, 14]


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


def test_dying_workers_leave_the_same_stream(capture: Path, stream: Path, tmp_path: Path) -> None:
    rng = random.Random(3)
    left = 10

    def die(iterations: int) -> None:
        nonlocal left
        if left and rng.random() < 0.3:
            left -= 1
            raise DiedError

    path = tmp_path / "stream"
    train(run_of(capture, path), partial(do_here, report=die))
    assert left == 0
    assert contents(path) == contents(stream)


def test_a_driver_may_die_at_any_moment(capture: Path, trained: Path, tmp_path: Path) -> None:
    stream, path = trained / "stream", tmp_path / "died"
    index = (stream / "index.bin").read_bytes()
    for num_bytes in range(0, len(index) + 1, 200):
        shutil.copytree(trained / "pieces", path)
        (path / "index.bin").write_bytes(index[:num_bytes])
        joiner = Joiner(run_of(capture, path))
        found = joiner.begin(resumed=True)
        new = [record for _, records in joiner.go_on() for record in records]
        assert [record.first_frame for record in found + new] == [*range(0, FRAMES, 2)]
        joiner.finish()
        assert contents(path) == contents(stream)
        shutil.rmtree(path)


WARM, IN_SEAM = 20, 40
"""Iterations of a window, and of a window in a seam."""
DEATHS = {
    "genesis": [(40, 20), (60, 40)],  # before, and in a settle round
    "part-0": [(5 * WARM, 4 * WARM)],  # in a segment
    # In the warm-up, and in the approach.
    "part-1": [(2 * WARM, 1 * WARM), (2 * WARM + 3 * IN_SEAM, 2 * WARM + 2 * IN_SEAM)],
    "seam-1": [(2 * IN_SEAM, 1 * IN_SEAM), (3 * IN_SEAM, 2 * IN_SEAM)],  # in a segment, after one
}
"""Iterations after which a task dies, and those that it goes on after."""


def test_from_store_to_store_dead_tasks_go_on_from_checkpoints(capture: Path, stream: Path) -> None:
    begun = defaultdict[str, list[int]](list)

    def do(task: Task) -> None:
        deaths, is_new = [killed_at for killed_at, _ in DEATHS[task.name]], True

        def report(done: int) -> None:
            nonlocal is_new
            if is_new:
                begun[task.name].append(done)
                is_new = False
            if deaths and done >= deaths[0]:
                del deaths[0]
                is_new = True
                raise DiedError
            assert done <= task.iterations

        do_here(task, report, keep_s=0.0)

    with s3_server() as server:
        server.upload(capture, "captures/one")
        url = f"s3://{BUCKET}/streams/one"
        train(run_of(f"s3://{BUCKET}/captures/one", url), do)
        assert server.files("streams/one") == contents(stream)
        assert not verify_stream(url).live
    assert begun == {name: [0, *(again for _, again in of)] for name, of in DEATHS.items()}
