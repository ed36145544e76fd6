"""The contract of every storage, and what local folders give and write."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from codec.errors import CodecError, CorruptError, UnreadableError
from codec.storage import folder as growingfolder
from codec.storage.folder import FolderStorage, GrowingFolder
from codec.storage.objectstore import open_store
from codec.storage.storage import Shape, StorageRoot
from codec.stream.reader import StreamReader
from codec.tools.audit import summarise, verify_stream
from tests.support.hostile import refused
from tests.support.stores.s3_server import BUCKET
from tests.support.tiny_stream import write_tiny


@dataclass
class Held:
    """A storage, with functions that add and remove files."""

    storage: StorageRoot
    put: Callable[[str, bytes], None]
    delete: Callable[[str], None]


def put_file(path: Path, data: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data)


@pytest.fixture(params=["folder", "s3"])
def held(request: pytest.FixtureRequest, tmp_path: Path) -> Held:
    folder = tmp_path / "place"
    if request.param == "folder":
        folder.mkdir()
        put, delete = (lambda n, d: put_file(folder / n, d)), (lambda n: (folder / n).unlink())
        return Held(FolderStorage(folder), put, delete)
    s3, key = request.getfixturevalue("s3"), f"{request.node.name}/place"
    put, delete = ((lambda n, d: s3.put(f"{key}/{n}", d)), (lambda n: s3.delete(f"{key}/{n}")))
    return Held(open_store(f"s3://{BUCKET}/{key}"), put, delete)


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


def test_links_may_lead_anywhere_inside_and_nowhere_else(tmp_path: Path) -> None:
    (tmp_path / "secret").write_bytes(b"secret")
    folder = tmp_path / "folder"
    (folder / "deep" / "er").mkdir(parents=True)
    (folder / "deep" / "file").write_bytes(b"inside")
    links = {
        **{"inside": "deep/file", "absolute": str(folder / "deep" / "file"), "chain": "inside"},
        **{"around": "../folder/deep/file", "dir": "deep", "deep/er/up": "../file"},
        **{"out": "../secret", "out-absolute": str(tmp_path / "secret"), "out-chain": "out"},
        **{"parent": "..", "zero": "/dev/zero", "proc": "/proc/self/environ"},
    }
    for name, target in links.items():
        (folder / name).symlink_to(target)
    # A folder whose name has the same beginning is a different one.
    (tmp_path / "folder-2").mkdir()
    (tmp_path / "folder-2" / "file").write_bytes(b"x")
    storage = FolderStorage(folder)
    for path in ("inside", "absolute", "around", "chain", "dir/file", "deep/er/up"):
        assert storage.read(path, 10) == b"inside"
        assert storage.holds(path)
    for path in (
        *("out", "out-absolute", "out-chain", "parent/secret", "zero", "../secret", "proc"),
        "../folder-2/file",
    ):
        refused(CorruptError, "a link points outside its folder", storage.read, path, 10)
        assert not storage.holds(path)


def test_a_folder_below_is_bound_to_itself_and_to_the_root(tmp_path: Path) -> None:
    for name in ("root/a", "root/b", "other"):
        (tmp_path / name).mkdir(parents=True)
        (tmp_path / name / "file").write_bytes(name.encode())
    (tmp_path / "root" / "a" / "link").symlink_to("../b/file")
    (tmp_path / "root" / "out").symlink_to("../other")
    (tmp_path / "root" / "in").symlink_to("b")
    root = FolderStorage(tmp_path / "root")
    assert root.below("in").read("file", 10) == root.read("a/link", 10) == b"root/b"
    for folder, path in (("a", "link"), ("out", "file"), ("a", "../b/file")):
        with pytest.raises(CorruptError, match="points outside"):
            root.below(folder).read(path, 10)


def make_device(path: Path) -> None:
    try:
        os.mknod(path, 0o20644, os.makedev(1, 5))
    except OSError as error:
        pytest.skip(f"no devices here: {error}")


ODD: dict[str, Callable[[Path], object]] = {
    "fifo": os.mkfifo,
    "folder": Path.mkdir,
    "circle": lambda path: path.symlink_to(path.name),
    "device": make_device,
    "x" * 300: lambda path: None,
}


@pytest.mark.parametrize("name", ODD)
def test_what_is_not_a_regular_file_is_refused_at_once(tmp_path: Path, name: str) -> None:
    ODD[name](tmp_path / name)
    storage = FolderStorage(tmp_path)
    refused(CorruptError, "cannot be read: ", storage.read, name, 10)
    assert not storage.holds(name)
    # It exists, or cannot be inspected; reading it raises the reason.
    assert storage.stamp(name) is not None
    assert list(storage.sizes(".")) == []


@pytest.mark.parametrize("swapped", ["deep", "deep/file"])
def test_a_link_after_a_look(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, swapped: str) -> None:
    (tmp_path / "away").mkdir()
    (tmp_path / "away" / "file").write_bytes(b"secret")
    (tmp_path / "folder" / "deep").mkdir(parents=True)
    (tmp_path / "folder" / "deep" / "file").write_bytes(b"inside")
    look = FolderStorage._resolved

    def look_and_swap(self: FolderStorage, path: Path) -> tuple[str, str]:
        found = look(self, path)
        (tmp_path / "folder" / swapped).rename(tmp_path / "kept")
        target = tmp_path / "away" / ("file" if swapped.endswith("file") else "")
        (tmp_path / "folder" / swapped).symlink_to(target)
        return found

    monkeypatch.setattr(FolderStorage, "_resolved", look_and_swap)
    refused(CorruptError, "", lambda: FolderStorage(tmp_path / "folder").read("deep/file", 10))


def test_a_folder_that_is_gone_says_so(tmp_path: Path) -> None:
    storage = FolderStorage(tmp_path / "absent")
    refused(CorruptError, "is not a folder", storage.check)
    with pytest.raises(FileNotFoundError):  # the error that a Python caller expects
        storage.check()
    (tmp_path / "file").touch()
    with pytest.raises(CorruptError, match="is not a folder") as told:
        FolderStorage(tmp_path / "file").check()
    assert not isinstance(told.value, OSError)
    refused(UnreadableError, r"absent cannot be listed: No such file", storage.folders, ("m",))
    assert storage.stamp("m") is None


@pytest.mark.parametrize("last", [1, 2, 3])
def test_no_thread_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, last: int) -> None:
    """Ctrl-C arrives while thread number `last` starts, before its pool has registered it; the
    writes begun until then go on after it."""
    place = GrowingFolder(tmp_path / "s", Shape(log="log", head="head", folder="objects"))
    place.begin(b"{}")
    started: list[threading.Thread] = []
    begun: list[Path] = []
    ended: list[Path] = []
    raised = threading.Event()

    def write_slowly(path: Path, data: bytes) -> None:
        begun.append(path)
        raised.wait()
        ended.append(path)

    def start_interrupted(thread: threading.Thread) -> None:
        start(thread)
        started.append(thread)
        if len(started) == last:
            try:
                signal.raise_signal(signal.SIGINT)
            finally:
                raised.set()

    start = threading.Thread.start
    monkeypatch.setattr(growingfolder, "write_atomic", write_slowly)
    monkeypatch.setattr(threading.Thread, "start", start_interrupted)
    refused(KeyboardInterrupt, "", place.add, 0, {str(number): b"" for number in range(4)})
    assert len(begun) == len(ended) == 4
    assert not any(thread.is_alive() for thread in started)
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_ctrl_c_takes_back_no_record_that_may_have_been_seen(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    place = GrowingFolder(tmp_path / "s", Shape(log="log", head="head", folder="objects"))
    place.begin(b"{}")
    fsync = os.fsync

    def interrupted(descriptor: int) -> None:
        signal.raise_signal(signal.SIGINT)
        fsync(descriptor)

    monkeypatch.setattr(os, "fsync", interrupted)
    refused(KeyboardInterrupt, "", place.append, 0, b"record")
    assert (tmp_path / "s" / "log").read_bytes() == b"record"
