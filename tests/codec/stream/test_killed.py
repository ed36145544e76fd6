"""A writer that is killed many times, and a reader that follows it all the time.

What this proves: the writer is a real process that dies by SIGKILL, so no handler and no `finally`
of it runs. At every poll, before, during and after a kill, the reader sees only whole records, in
order. Their objects exist, are complete, and equal those of an undisturbed writer byte for byte.
The reader never has to give up, and no record that it has seen disappears. After each kill the
folder passes `verify`, and the next writer continues after the last record.

The moments are drawn from a fixed seed, from before the folder exists to after its last record.
The progress of a writer at a moment depends on the machine, so the moments adapt until half of the
kills precede a whole segment, and the test counts that many kills hit a write. A kill cannot show a
loss of power, when the disk loses everything that no fsync has secured:
`test_a_failure_at_any_step_of_any_write` in test_failures.py covers that order.
"""

from __future__ import annotations

import os
import random
import signal
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from codec.stream.index import record_bytes
from codec.stream.reader import StreamReader
from codec.tools.audit import verify_stream
from tests.support.forked.forked_writer import NUM_FRAMES, forked_manifest, forked_updates, write
from tests.support.forked.forker import Forker

KILLS, IN_A_WRITE = 100, 5


@pytest.fixture
def forker() -> Iterator[Forker]:
    forker = Forker()
    yield forker
    forker.close()


class Follower:
    """A reader that is opened as soon as there is a stream, and is kept from then on."""

    def __init__(self, path: Path, whole: dict[str, bytes]) -> None:
        self._path = path
        self._whole = whole
        self._reader: StreamReader | None = None

    def poll(self) -> None:
        """Polls once; asserts that everything new is correct."""
        if self._reader is None:
            if not (self._path / "manifest.json").exists():
                return
            self._reader = StreamReader(self._path)
            fresh = self._reader.records
        else:
            before = len(self._reader.records)
            count = self._reader.refresh()
            fresh = self._reader.records[before:]
            assert len(fresh) == count
        for record in fresh:
            assert self._whole["index.bin"].startswith(self._index())
            for part in self._reader.manifest.parts:
                found = self._reader.read_object(record.segment, part)
                assert found.data == self._whole[f"segments/{record.segment}/{part}"]
            birth = record.first_frame + record.num_frames - 1
            assert self._reader.slice(birth, self._reader.manifest.num_layers).birth == birth

    def _index(self) -> bytes:
        """The current bytes of the index: whole records, and at most a part of one."""
        return (self._path / "index.bin").read_bytes()


def files(path: Path) -> dict[str, bytes]:
    return {str(p.relative_to(path)): p.read_bytes() for p in path.rglob("*") if p.is_file()}


def fell_into_a_write(path: Path) -> bool:
    """Whether there is data that no index names: the last writer was killed in a write."""
    indexed = 0
    if (path / "manifest.json").exists():
        size = record_bytes(forked_manifest().num_layers)
        indexed = (path / "index.bin").stat().st_size // size
    folders = [int(p.name) for p in path.glob("segments/*")]
    return any(path.rglob(".*.tmp")) or any(number >= indexed for number in folders)


@pytest.fixture
def folder(tmp_path: Path) -> Iterator[Path]:
    """A folder in memory if possible: kills have the same effect there, and an fsync is free."""
    memory = Path("/dev/shm")
    if not os.access(memory, os.W_OK):
        yield tmp_path
        return
    with tempfile.TemporaryDirectory(dir=memory) as path:
        yield Path(path)


def test_many_kills_and_a_reader_that_follows(folder: Path, forker: Forker) -> None:
    write(folder / "whole", forked_updates())
    whole = files(folder / "whole")
    rng = random.Random(0)
    kills = in_a_write = polls = 0
    streams = [folder / "0"]
    follower = Follower(streams[-1], whole)
    num_frames = 0
    patience_s = 0.005
    # Writes are short, so the kills continue until enough of them have hit a write.
    while kills < KILLS or (in_a_write <= IN_A_WRITE and kills < 10 * KILLS):
        path = streams[-1]
        pid = forker.start(path)
        until_s = time.perf_counter() + rng.uniform(0, patience_s)
        while time.perf_counter() < until_s:
            follower.poll()
            polls += 1
        os.kill(pid, signal.SIGKILL)
        ended = forker.ended()
        assert ended in (0, -signal.SIGKILL)
        follower.poll()
        polls += 1
        if ended:
            kills += 1
            in_a_write += fell_into_a_write(path)
        grew, live = False, True
        if (path / "manifest.json").exists():
            summary = verify_stream(path)
            assert summary.num_frames >= num_frames
            grew, live = summary.num_frames > num_frames, summary.live
            num_frames = summary.num_frames
        # For any speed of the machine, half of the kills precede a whole segment.
        patience_s = min(patience_s * (0.8 if grew else 1.25), 1.0)
        if not live:
            assert files(path) == whole
            streams.append(folder / str(len(streams)))
            follower = Follower(streams[-1], whole)
            num_frames = 0
    # Otherwise the kills hit no writes, or the reader did not follow.
    assert in_a_write > IN_A_WRITE
    assert polls > KILLS
    assert len(streams) > 1
    forker.start(streams[-1])
    assert forker.ended() == 0
    follower.poll()
    assert files(streams[-1]) == whole


def test_a_folder_of_a_writer_killed_before_it_was_a_stream(tmp_path: Path) -> None:
    path = tmp_path / "s"
    (path / "segments").mkdir(parents=True)
    (path / "index.bin").touch()
    (path / ".manifest.json.tmp").write_bytes(forked_manifest().to_json()[:50])
    write(path, forked_updates())
    assert verify_stream(path).num_frames == NUM_FRAMES
