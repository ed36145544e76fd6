"""Streams written to a real S3 server: the same bytes as in a folder, despite kills and other
writers.

The kills: the writers are processes that die by SIGKILL at moments drawn from a fixed seed, from
before the first request to after the last one. After each kill the stream passes `verify`, and no
written frame disappears; at the end it equals an undisturbed stream byte for byte.
"""

from __future__ import annotations

import os
import random
import signal
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest

from codec.errors import CodecError, CorruptError, InvalidError, UnwritableError
from codec.slots.update import Update
from codec.storage import objectstore
from codec.stream import StreamReader, StreamWriter
from codec.tools.audit import verify_stream
from tests.support.forked.forked_writer import forked_manifest, forked_updates, write
from tests.support.forked.forker import Forker
from tests.support.stores.s3_server import BUCKET, S3Server, s3_server
from tests.support.tiny_stream import tiny_manifest

URL = f"s3://{BUCKET}/deep/stream"
KEY = "deep/stream"
KILLS = 20


@pytest.fixture
def server() -> Iterator[S3Server]:
    with s3_server() as server:
        yield server


def files(path: Path) -> dict[str, bytes]:
    return {str(p.relative_to(path)): p.read_bytes() for p in path.rglob("*") if p.is_file()}


def append_some(writer: StreamWriter, slices: Sequence[Update]) -> None:
    """Appends the slices that the writer does not have yet."""
    for slice in slices:
        if slice.birth >= writer.next_birth:
            writer.append(slice)


def test_a_store_gets_the_bytes_of_a_folder(server: S3Server, tmp_path: Path) -> None:
    slices = forked_updates()
    write(tmp_path / "s", slices)
    write(URL, slices)
    assert server.files(KEY) == files(tmp_path / "s")
    assert verify_stream(URL) == verify_stream(tmp_path / "s")
    with pytest.raises(InvalidError, match=f"^{URL} is finished; "):
        StreamWriter.resume(URL)
    with pytest.raises(InvalidError, match=f"^{URL} is not empty; "):
        StreamWriter.create(URL, forked_manifest())


def test_a_segment_takes_a_request_for_each_object_and_one_for_the_index(
    server: S3Server, monkeypatch: pytest.MonkeyPatch
) -> None:
    import obstore

    keys: list[str] = []
    put = obstore.put

    def counted(store: Any, key: str, *arguments: Any, **options: Any) -> Any:
        keys.append(key.rpartition(f"{KEY}/")[2])
        return put(store, key, *arguments, **options)

    monkeypatch.setattr(obstore, "put", counted)
    write(URL, forked_updates())
    segments = [
        [*(f"segments/{segment}/{part}" for part in ("0", "masks", "snapshot-0")), "index.bin"]
        for segment in range(16)
    ]
    inner = [key for segment in segments for key in segment]
    assert keys == ["index.bin", "manifest.json", *inner, "index.bin", "manifest.json"]


@pytest.mark.slow
def test_many_kills(server: S3Server, tmp_path: Path) -> None:
    write(tmp_path / "whole", forked_updates())
    whole = files(tmp_path / "whole")
    rng = random.Random(0)
    forker = Forker()
    kills = number = num_frames = torn = 0
    patience_s = 0.4
    try:
        while kills < KILLS or not number:
            key = f"killed/{number}"
            url = f"s3://{BUCKET}/{key}"
            pid = forker.start(url)
            time.sleep(rng.uniform(0, patience_s))
            os.kill(pid, signal.SIGKILL)
            ended = forker.ended()
            assert ended in (0, -signal.SIGKILL)
            kills += ended != 0
            found = server.files(key)
            assert found.keys() <= whole.keys()
            if "manifest.json" not in found:
                continue
            summary = verify_stream(url)
            assert summary.num_frames >= num_frames
            grew, num_frames = summary.num_frames > num_frames, summary.num_frames
            torn += len({name.split("/")[1] for name in found if "/" in name}) > (
                summary.num_segments
            )
            for name, data in found.items():
                assert data == whole[name] or name in ("index.bin", "manifest.json")
            patience_s = min(patience_s * (0.8 if grew else 1.25), 2.0)
            if not summary.live:
                assert found == whole
                number, num_frames = number + 1, 0
        forker.start(f"s3://{BUCKET}/killed/{number}")
        assert forker.ended() == 0
    finally:
        forker.close()
    assert server.files(f"killed/{number}") == whole
    assert torn > 0  # some died between the objects of a segment and its record


def test_of_two_writers_the_one_that_came_later_goes_on(server: S3Server, tmp_path: Path) -> None:
    slices = forked_updates()
    write(tmp_path / "s", slices)
    first = StreamWriter.create(URL, forked_manifest())
    for slice in slices[:8]:
        first.append(slice)
    segments = len(StreamReader(URL).records)
    second = StreamWriter.resume(URL)
    with pytest.raises(InvalidError, match=f"^{URL}: another writer has written to this stream; "):
        append_some(first, slices[8:])
    assert verify_stream(URL).num_segments == segments
    with pytest.raises(InvalidError, match="another writer"):
        first.close()  # with a short segment, of other bytes than the whole one
    assert verify_stream(URL).live
    with second:
        append_some(second, slices)
    assert server.files(KEY) == files(tmp_path / "s")


def test_of_two_that_begin_at_once_one_is_refused(
    server: S3Server, monkeypatch: pytest.MonkeyPatch
) -> None:
    from codec.storage.growingstore import GrowingStore

    StreamWriter.create(URL, forked_manifest())
    monkeypatch.setattr(GrowingStore, "check_unused", lambda self: None)  # checked just before
    with pytest.raises((InvalidError, CorruptError)):
        StreamWriter.create(URL, tiny_manifest())
    assert verify_stream(URL).num_segments == 0


def test_a_store_that_is_gone_is_one_line_and_the_writer_goes_on_when_it_is_back(
    server: S3Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(objectstore, "PATIENT", objectstore.BRIEF)
    slices = forked_updates()
    write(tmp_path / "s", slices)
    with StreamWriter.create(URL, forked_manifest()) as writer:
        for n in range(len(slices)):
            if n in (6, 11, 20):
                server.stop()
                with pytest.raises(UnwritableError) as caught:
                    append_some(writer, slices[n : n + 3])  # one of them completes a segment
                assert str(caught.value).startswith(f"{URL}/segments/")
                assert "\n" not in str(caught.value)
                assert len(str(caught.value)) < 400
                server.start()
            append_some(writer, slices[n : n + 1])
    assert server.files(KEY) == files(tmp_path / "s")


def test_what_a_store_refuses_is_one_line(server: S3Server) -> None:
    with pytest.raises(CodecError, match=r"^s3://no-such-bucket/s/") as caught:
        StreamWriter.create("s3://no-such-bucket/s", forked_manifest())
    assert "NoSuchBucket" in str(caught.value)
    assert "\n" not in str(caught.value)
