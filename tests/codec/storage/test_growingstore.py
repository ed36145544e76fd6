"""Streams written to a real S3 server: the same bytes as in a folder, despite other writers and a
store that goes away; test_killed.py has the kills."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest

from codec.errors import CodecError, CorruptError, InvalidError, UnwritableError
from codec.slots.update import Update
from codec.storage import objectstore
from codec.storage.objectstore import RetryPolicy
from codec.stream import StreamReader, StreamWriter
from codec.tools.audit import verify_stream
from tests.support.forked.forked_writer import forked_manifest, forked_updates, write
from tests.support.stores.s3_server import BUCKET, S3Server, s3_server
from tests.support.tiny_stream import files_of, tiny_manifest

UPDATES = forked_updates()[:11]
"""Of a stream of five segments of two frames, each with three objects."""


@pytest.fixture(scope="module")
def server() -> Iterator[S3Server]:
    with s3_server() as server:
        yield server


@pytest.fixture
def key(server: S3Server, request: pytest.FixtureRequest) -> str:
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
    server: S3Server, key: str, url: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
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
        [*(f"segments/{segment}/{part}" for part in ("0", "masks", "snapshot-0")), "index.bin"]
        for segment in range(5)
    ]
    inner = [key for segment in segments for key in segment]
    assert keys == ["index.bin", "manifest.json", *inner, "index.bin", "manifest.json"]
    assert server.files(key) == files_of(tmp_path / "s")
    assert verify_stream(url) == verify_stream(tmp_path / "s")
    with pytest.raises(InvalidError, match="is finished; "):
        StreamWriter.resume(url)
    with pytest.raises(InvalidError, match="is not empty; "):
        StreamWriter.create(url, forked_manifest())


def test_of_two_writers_the_later_one(server: S3Server, key: str, url: str, tmp_path: Path) -> None:
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
    assert server.files(key) == files_of(tmp_path / "s")


def test_two_beginning_at_once(server: S3Server, url: str, monkeypatch: pytest.MonkeyPatch) -> None:
    from codec.storage.growingstore import GrowingStore

    StreamWriter.create(url, forked_manifest())
    monkeypatch.setattr(GrowingStore, "check_unused", lambda self: None)  # checked just before
    with pytest.raises((InvalidError, CorruptError)):
        StreamWriter.create(url, tiny_manifest())
    assert verify_stream(url).num_segments == 0


def test_a_writer_goes_on_when_a_store_that_was_gone_is_back(
    server: S3Server, key: str, url: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    quick = RetryPolicy(10.0, 0.001, 0.001, max_retries=1)
    monkeypatch.setattr(objectstore, "PATIENT", quick)
    write(tmp_path / "s", UPDATES)
    with StreamWriter.create(url, forked_manifest()) as writer:
        for n in range(len(UPDATES)):
            if n in (4, 9):
                server.stop()
                with pytest.raises(UnwritableError) as caught:
                    append_some(writer, UPDATES[n : n + 3])  # one of them completes a segment
                assert str(caught.value).startswith(f"{url}/segments/")
                assert "\n" not in str(caught.value)
                assert len(str(caught.value)) < 400
                server.start()
            append_some(writer, UPDATES[n : n + 1])
    assert server.files(key) == files_of(tmp_path / "s")


def test_what_a_store_refuses_is_one_line(server: S3Server) -> None:
    with pytest.raises(CodecError, match=r"^s3://no-such-bucket/s/") as caught:
        StreamWriter.create("s3://no-such-bucket/s", forked_manifest())
    assert "NoSuchBucket" in str(caught.value)
    assert "\n" not in str(caught.value)
