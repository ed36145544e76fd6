"""The contract of every storage, for every place of the files."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from codec.errors import CodecError, CorruptError
from codec.storage.openstorage import open_storage
from codec.storage.storage import Storage
from codec.stream.reader import StreamReader
from codec.tools.audit import summarise, verify_stream
from tests.support.hostile import refused
from tests.support.stores.s3_server import BUCKET, S3Server, s3_server
from tests.support.tiny_stream import write_tiny


@dataclass
class Held:
    """A storage, with functions that add and remove files."""

    storage: Storage
    put: Callable[[str, bytes], None]
    delete: Callable[[str], None]


@pytest.fixture(scope="module")
def server() -> Iterator[S3Server]:
    with s3_server() as server:
        yield server


def put_file(path: Path, data: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data)


@pytest.fixture(params=["folder", "s3"])
def held(request: pytest.FixtureRequest, tmp_path: Path) -> Held:
    folder = tmp_path / "place"
    if request.param == "folder":
        folder.mkdir()
        put, delete = (lambda n, d: put_file(folder / n, d)), (lambda n: (folder / n).unlink())
        return Held(open_storage(folder), put, delete)
    server, key = request.getfixturevalue("server"), f"{request.node.name}/place"
    put, delete = (
        (lambda n, d: server.put(f"{key}/{n}", d)),
        (lambda n: server.delete(f"{key}/{n}")),
    )
    return Held(open_storage(f"s3://{BUCKET}/{key}"), put, delete)


def test_a_file_is_read_from_an_offset_up_to_a_limit(held: Held) -> None:
    held.put("a/file", b"0123456789")
    held.put("empty", b"")
    read = held.storage.read
    assert read("a/file", 10) == b"0123456789"
    assert read("a/file", 3, 7) == b"789"
    assert read("a/file", 0, 10) == read("a/file", 0, 99) == read("empty", 0) == b""
    assert held.storage.below("a").read("file", 10) == b"0123456789"
    for limit_bytes, offset in ((9, 0), (2, 7), (0, 9)):
        with pytest.raises(CorruptError, match=rf"a/file is longer than {limit_bytes} bytes$"):
            read("a/file", limit_bytes, offset)


def test_what_is_missing_is_named_with_its_whole_place(held: Held) -> None:
    held.put("a/file", b"x")
    for path in ("none", "a/none", "none/none", "a/file/none"):
        place = held.storage.place(path)
        assert place.endswith(f"place/{path}")
        error = refused(CorruptError, "", held.storage.read, path, 10, if_missing="take another")
        assert str(error) == f"{place} is missing; take another"
        assert held.storage.stamp(path) is None
        assert not held.storage.holds(path)


def test_another_content_has_another_stamp(held: Held) -> None:
    stamps = []
    for data in (b"one", b"two", b"three", b""):
        held.put("file", data)
        stamp = held.storage.stamp("file")
        assert stamp is not None
        assert stamp.size_bytes == len(data)
        assert stamp == held.storage.stamp("file")
        stamps.append(stamp)
    assert len(set(stamps)) == len(stamps)
    assert held.storage.holds("file")
    held.delete("file")
    assert held.storage.stamp("file") is None


def test_folders_are_found_by_a_file_that_they_hold(held: Held) -> None:
    held.storage.check()
    assert held.storage.folders(("m", "i")) == {}
    for path in ("one/m", "one/i", "two words/m", "three/i", "m", ".hidden/m", "four/deep/m"):
        held.put(path, path.encode())
    found = held.storage.folders(("m", "i"))
    assert sorted(found) == ["one", "two words"]
    assert found["one"] == (held.storage.stamp("one/m"), held.storage.stamp("one/i"))
    assert found["two words"] == (held.storage.stamp("two words/m"), None)


def test_sizes_are_those_of_the_files_two_levels_below(held: Held) -> None:
    assert dict(held.storage.sizes("segments")) == {}
    expected = {}
    for segment in range(12):
        for layer in range(3):
            path = f"segments/{segment}/{layer}"
            expected[path] = 5 * segment + layer
            held.put(path, bytes(expected[path]))
    held.put("other/0/0", b"x")
    assert dict(held.storage.sizes("segments")) == expected
    held.put("within/segments/0/0", b"xyz")
    assert dict(held.storage.below("within").sizes("segments")) == {"segments/0/0": 3}


def test_a_stream_is_read_and_verified_where_it_lies(held: Held, tmp_path: Path) -> None:
    local = tmp_path / "local"
    write_tiny(local, 10)
    for path in local.rglob("*"):
        if path.is_file():
            held.put(f"s/{path.relative_to(local)}", path.read_bytes())
    place = held.storage.name + "/s"
    assert verify_stream(place) == verify_stream(local) == summarise(place)
    here, there = StreamReader(local), StreamReader(held.storage.below("s"))
    assert there.name == place
    assert there.records == here.records or str(there.records) == str(here.records)
    for birth in here.births:
        assert (there.slice(birth, 2).splats.means == here.slice(birth, 2).splats.means).all()
    data = (local / "segments" / "1" / "1").read_bytes()
    held.put("s/segments/1/1", data[:-1] + bytes([data[-1] ^ 1]))
    assert str(refused(CodecError, "", verify_stream, place)).startswith(f"{place}/segments/1/1: ")
    held.delete("s/segments/1/1")
    error = refused(CodecError, "", verify_stream, place)
    assert str(error).startswith(f"{place}/segments/1/1 is missing; ")
