"""Streams written to a store, and writers that are killed while a reader follows, anywhere."""

from __future__ import annotations

import contextlib
import os
import random
import signal
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from codec.errors import CorruptError, InvalidError, UnwritableError
from codec.slots.slotlayout import Update
from codec.storage import objectstore
from codec.storage.objectstore import RetryPolicy
from codec.storage.openstorage import Target, open_storage, parse_target
from codec.stream import StreamReader, StreamWriter
from codec.stream.segment import record_bytes
from codec.tools.audit import verify_stream
from tests.support.forked.forked_writer import (
    NUM_FRAMES,
    Forker,
    forked_manifest,
    forked_updates,
    write,
)
from tests.support.hostile import refused
from tests.support.stores.s3_server import BUCKET, S3Server, s3_server
from tests.support.tiny_stream import files_of, tiny_manifest
from tests.support.waiting import wait_until

UPDATES = forked_updates()[:11]
"""Of a stream of five segments of two frames, each with three objects."""


@pytest.fixture
def key(s3: S3Server, request: pytest.FixtureRequest) -> str:
    return f"deep/{request.node.name}"


@pytest.fixture
def url(key: str) -> str:
    return f"s3://{BUCKET}/{key}"


def append_some(writer: StreamWriter, slices: Sequence[Update]) -> None:
    """Appends the slices that the writer does not have yet."""
    for slice in slices:
        if slice.birth >= writer.next_birth:
            writer.append(slice)


def test_a_store_gets_the_bytes_of_a_folder_in_a_request_for_each_object(
    s3: S3Server, key: str, url: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import obstore

    keys: list[str] = []
    put = obstore.put

    def counted(store: Any, path: str, *arguments: Any, **options: Any) -> Any:
        keys.append(path.rpartition(f"{key}/")[2])
        return put(store, path, *arguments, **options)

    monkeypatch.setattr(obstore, "put", counted)
    write(tmp_path / "s", UPDATES)
    write(url, UPDATES)
    segments = [
        [*(f"segments/{segment}/{part}" for part in ("0", "skipmaps", "keyframe-0")), "index.bin"]
        for segment in range(5)
    ]
    inner = [key for segment in segments for key in segment]
    assert keys == ["index.bin", "manifest.json", *inner, "index.bin", "manifest.json"]
    assert s3.files(key) == files_of(tmp_path / "s")
    assert verify_stream(url) == verify_stream(tmp_path / "s")
    refused(InvalidError, "is finished; ", StreamWriter.resume, url)
    refused(InvalidError, "is not empty; ", StreamWriter.create, url, forked_manifest())


def test_of_two_writers_the_later_one(s3: S3Server, key: str, url: str, tmp_path: Path) -> None:
    write(tmp_path / "s", UPDATES)
    first = StreamWriter.create(url, forked_manifest())
    for slice in UPDATES[:6]:
        first.append(slice)
    segments = len(StreamReader(url).records)
    second = StreamWriter.resume(url)
    with pytest.raises(InvalidError, match=f"^{url}: another writer has written to this stream; "):
        append_some(first, UPDATES[6:])
    assert verify_stream(url).num_segments == segments
    with pytest.raises(InvalidError, match="another writer"):
        first.close()  # with a short segment, of other bytes than the whole one
    assert verify_stream(url).live
    with second:
        append_some(second, UPDATES)
    assert s3.files(key) == files_of(tmp_path / "s")


def test_two_beginning_at_once(s3: S3Server, url: str, monkeypatch: pytest.MonkeyPatch) -> None:
    from codec.storage.growingstore import GrowingStore

    StreamWriter.create(url, forked_manifest())
    monkeypatch.setattr(GrowingStore, "check_unused", lambda self: None)  # checked just before
    refused((InvalidError, CorruptError), "", StreamWriter.create, url, tiny_manifest())
    assert verify_stream(url).num_segments == 0


def test_a_writer_goes_on_when_a_store_that_was_gone_is_back(
    s3: S3Server, key: str, url: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    quick = RetryPolicy(1.0, 0.001, 0.001, max_retries=1)
    monkeypatch.setattr(objectstore, "PATIENT", quick)
    write(tmp_path / "s", UPDATES)
    with StreamWriter.create(url, forked_manifest()) as writer:
        for n in range(len(UPDATES)):
            if n in (4, 9):
                s3.stop()
                with pytest.raises(UnwritableError) as caught:
                    append_some(writer, UPDATES[n : n + 3])  # one of them completes a segment
                assert str(caught.value).startswith(f"{url}/segments/")
                assert "\n" not in str(caught.value)
                assert len(str(caught.value)) < 400
                s3.start()
            append_some(writer, UPDATES[n : n + 1])
    assert s3.files(key) == files_of(tmp_path / "s")


NUM_SEGMENTS = -(-NUM_FRAMES // forked_manifest().segment_frames)


@pytest.fixture
def folder(tmp_path: Path) -> Iterator[Path]:
    """A folder in memory if possible: kills have the same effect there, and an fsync is free."""
    memory = Path("/dev/shm")
    if not os.access(memory, os.W_OK):
        yield tmp_path
        return
    with tempfile.TemporaryDirectory(dir=memory) as path:
        yield Path(path)


def files(path: Path) -> dict[str, bytes]:
    return {str(p.relative_to(path)): p.read_bytes() for p in path.rglob("*") if p.is_file()}


def is_torn(found: dict[str, bytes]) -> bool:
    """Whether there is data that no index names: the last writer was killed in a write."""
    index = found.get("index.bin", b"") if "manifest.json" in found else b""
    indexed = len(index) // record_bytes(forked_manifest().num_layers)
    objects = [name.split("/")[1] for name in found if "/" in name]
    return any(n.endswith(".tmp") for n in found) or any(int(n) >= indexed for n in objects)


class Killed:
    """Streams that are written by writers that are killed; `target` and `files` say where stream
    number n is, and what is there."""

    def __init__(
        self,
        forker: Forker,
        whole: dict[str, bytes],
        target: Callable[[int], Target],
        files: Callable[[int], dict[str, bytes]],
    ) -> None:
        self._forker, self._whole, self._target, self._files = forker, whole, target, files
        self.kills = self.torn = self.number = self._num_frames = 0
        self._reader: StreamReader | None = None

    def poll(self) -> int:
        """Number of records that the reader knows; asserts that everything new is correct."""
        if self._reader is None:
            target = self._target(self.number)
            if not open_storage(target).holds("manifest.json"):
                return 0
            self._reader = StreamReader(target)
            fresh = self._reader.records
        else:
            before = len(self._reader.records)
            count = self._reader.refresh()
            fresh = self._reader.records[before:]
            assert len(fresh) == count
        for record in fresh:
            for part in self._reader.manifest.parts:
                found = self._reader.read_object(record.segment, part)
                assert found.data == self._whole[f"segments/{record.segment}/{part}"]
            birth = record.first_frame + record.num_frames - 1
            assert self._reader.slice(birth, self._reader.manifest.num_layers).birth == birth
        return len(self._reader.records)

    def kill_one(self, wait: Callable[[], object]) -> bool:
        """Starts a writer and kills it after `wait`. Whether the stream grew meanwhile."""
        pid = self._forker.start(self._target(self.number))
        wait()
        os.kill(pid, signal.SIGKILL)
        ended = self._forker.ended()
        assert ended in (0, -signal.SIGKILL)
        self.poll()
        found = self._files(self.number)
        self.kills += ended != 0
        self.torn += ended != 0 and is_torn(found)
        if "manifest.json" not in found:
            return False
        summary = verify_stream(self._target(self.number))
        assert summary.num_frames >= self._num_frames
        grew, self._num_frames = summary.num_frames > self._num_frames, summary.num_frames
        if not summary.live:
            assert found == self._whole
            self.number, self._reader, self._num_frames = self.number + 1, None, 0
        return grew

    def end(self) -> None:
        self._forker.start(self._target(self.number))
        assert self._forker.ended() == 0
        self.poll()
        assert self._files(self.number) == self._whole


@pytest.fixture(params=["folder", "store"])
def killed(request: pytest.FixtureRequest, folder: Path) -> Iterator[Killed]:
    write(folder / "whole", forked_updates())
    whole = files(folder / "whole")
    with contextlib.ExitStack() as stack:
        server = stack.enter_context(s3_server()) if request.param == "store" else None
        place = f"s3://{BUCKET}/killed" if server else str(folder)

        def found(number: int) -> dict[str, bytes]:
            return server.files(f"killed/{number}") if server else files(folder / str(number))

        forker = Forker()  # has the environment of the server
        stack.callback(forker.close)
        yield Killed(forker, whole, lambda n: parse_target(f"{place}/{n}"), found)


def test_a_stream_is_whole_after_kills(killed: Killed) -> None:
    """Each kill comes when the reader has seen more of the stream."""
    while killed.kills < 2:
        more = min(killed.poll() + 1, NUM_SEGMENTS)
        killed.kill_one(partial(wait_until, lambda more=more: killed.poll() >= more))
    killed.end()


@pytest.mark.deep
def test_many_kills_at_any_moment(killed: Killed) -> None:
    """The progress of a writer at a moment depends on the machine: the moments adapt until half of
    the kills precede a whole segment, and go on until enough of them have hit a write."""
    rng, patience_s, least = random.Random(0), 0.005, 5
    while killed.kills < 100 or not killed.number or killed.torn <= least:
        until_s = time.perf_counter() + rng.uniform(0, patience_s)

        def wait(until_s: float = until_s) -> None:
            while time.perf_counter() < until_s:
                killed.poll()

        grew = killed.kill_one(wait)
        patience_s = min(patience_s * (0.8 if grew else 1.25), 2.0)
        assert killed.kills < 1000
    killed.end()


def test_a_folder_of_a_writer_killed_before_it_was_a_stream(tmp_path: Path) -> None:
    path = tmp_path / "s"
    (path / "segments").mkdir(parents=True)
    (path / "index.bin").touch()
    (path / ".manifest.json.tmp").write_bytes(forked_manifest().to_json()[:50])
    write(path, forked_updates())
    assert verify_stream(path).num_frames == NUM_FRAMES
