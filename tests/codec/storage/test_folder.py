"""Local folders: only regular files inside them are accessible."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from codec.errors import CodecError, CorruptError, UnreadableError
from codec.interop.formats import read_splats
from codec.storage.folder import FolderStorage
from codec.tools.audit import summarise, verify_stream
from tests.support.hostile import refused
from tests.support.tiny_stream import write_tiny


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
def test_a_link_after_the_look(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, swapped: str
) -> None:
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


@pytest.mark.deep
def test_a_name_that_is_swapped_all_the_time_never_shows_what_it_leads_to(tmp_path: Path) -> None:
    for name, content in (("away", b"secret"), ("folder/deep", b"inside")):
        (tmp_path / name).mkdir(parents=True)
        (tmp_path / name / "file").write_bytes(content)
    folder, stop = tmp_path / "folder", threading.Event()

    def swap() -> None:
        while not stop.is_set():
            (folder / "deep").rename(folder / "kept")
            (folder / "deep").symlink_to("../away")
            (folder / "deep").unlink()
            (folder / "kept").rename(folder / "deep")

    swapper = threading.Thread(target=swap)
    swapper.start()
    storage, outcomes, reads = FolderStorage(folder), set[bytes | str](), 0
    try:
        while reads < 10_000 or b"inside" not in outcomes or len(outcomes) < 2:
            reads += 1
            try:
                outcomes.add(storage.read("deep/file", 10))
            except CodecError as error:
                outcomes.add(str(error).rpartition("/")[2].partition(":")[0])
    finally:
        stop.set()
        swapper.join()
    assert b"secret" not in outcomes


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


def test_nothing_waits_for_a_pipe(tmp_path: Path) -> None:
    write_tiny(tmp_path / "s", 8)
    reason = "cannot be read: it is not a regular file"
    for name in ("segments/1/0", "index.bin", "manifest.json"):
        (tmp_path / "s" / name).unlink()
        os.mkfifo(tmp_path / "s" / name)
        for command in (verify_stream, summarise):
            if command is verify_stream or "segments" not in name:  # info reads no object
                refused(CorruptError, f"{name} {reason}", command, tmp_path / "s")
    os.mkfifo(tmp_path / "x.ply")
    refused(CorruptError, rf"x\.ply {reason}", read_splats, tmp_path / "x.ply")
