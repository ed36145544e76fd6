"""Local folders: only regular files inside them are accessible."""

from __future__ import annotations

import os
import threading
import time
from pathlib import Path

import pytest

from codec.errors import CodecError, CorruptError, UnreadableError
from codec.interop.formats import read_splats
from codec.storage.folder import FolderStorage
from codec.tools.audit import summarise, verify_stream
from tests.support.tiny_stream import write_tiny

pytestmark = pytest.mark.timeout(30)


def test_links_may_lead_anywhere_inside_and_nowhere_else(tmp_path: Path) -> None:
    (tmp_path / "secret").write_bytes(b"secret")
    folder = tmp_path / "folder"
    (folder / "deep" / "er").mkdir(parents=True)
    (folder / "deep" / "file").write_bytes(b"inside")
    links = {
        "inside": "deep/file",
        "absolute": str(folder / "deep" / "file"),
        "around": "../folder/deep/file",
        "chain": "inside",
        "dir": "deep",
        "deep/er/up": "../file",
        "out": "../secret",
        "out-absolute": str(tmp_path / "secret"),
        "out-chain": "out",
        "parent": "..",
        "zero": "/dev/zero",
        "proc": "/proc/self/environ",
    }
    for name, target in links.items():
        (folder / name).symlink_to(target)
    storage = FolderStorage(folder)
    for path in ("inside", "absolute", "around", "chain", "dir/file", "deep/er/up"):
        assert storage.read(path, 10) == b"inside"
        assert storage.holds(path)
    for path in ("out", "out-absolute", "out-chain", "parent/secret", "zero", "../secret", "proc"):
        with pytest.raises(CorruptError, match="a link points outside its folder"):
            storage.read(path, 10)
        assert not storage.holds(path)
    # A folder whose name has the same beginning is a different one.
    (tmp_path / "folder-2").mkdir()
    (tmp_path / "folder-2" / "file").write_bytes(b"x")
    with pytest.raises(CorruptError, match="points outside"):
        storage.read("../folder-2/file", 10)


def test_a_folder_below_is_bound_to_itself_and_to_the_root(tmp_path: Path) -> None:
    for name in ("root/a", "root/b", "other"):
        (tmp_path / name).mkdir(parents=True)
        (tmp_path / name / "file").write_bytes(name.encode())
    (tmp_path / "root" / "a" / "link").symlink_to("../b/file")
    (tmp_path / "root" / "out").symlink_to("../other")
    (tmp_path / "root" / "in").symlink_to("b")
    root = FolderStorage(tmp_path / "root")
    assert root.below("in").read("file", 10) == b"root/b"
    for folder, path in (("a", "link"), ("out", "file"), ("a", "../b/file")):
        with pytest.raises(CorruptError, match="points outside"):
            root.below(folder).read(path, 10)
    assert root.read("a/link", 10) == b"root/b"


@pytest.mark.parametrize("kind", ["fifo", "folder", "circle", "long"])
def test_what_is_not_a_regular_file_is_refused_at_once(tmp_path: Path, kind: str) -> None:
    path = "x" * 300 if kind == "long" else "x"
    match kind:
        case "fifo":
            os.mkfifo(tmp_path / path)
        case "folder":
            (tmp_path / path).mkdir()
        case "circle":
            (tmp_path / path).symlink_to(path)
    storage = FolderStorage(tmp_path)
    with pytest.raises(CorruptError, match="cannot be read: "):
        storage.read(path, 10)
    assert not storage.holds(path)
    # It exists, or cannot be inspected; reading it raises the reason.
    assert storage.stamp(path) is not None
    assert list(storage.sizes(".")) == []


def test_a_device_is_refused(tmp_path: Path) -> None:
    if os.geteuid() != 0:
        pytest.skip("only root makes devices")
    try:
        os.mknod(tmp_path / "zero", 0o20644, os.makedev(1, 5))
    except OSError as error:
        pytest.skip(f"no devices here: {error}")
    with pytest.raises(CorruptError, match=r"cannot be read"):
        FolderStorage(tmp_path).read("zero", 10)


@pytest.mark.parametrize("swapped", ["deep", "deep/file"])
def test_a_link_that_comes_after_the_look_is_not_followed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, swapped: str
) -> None:
    """The path is swapped between its check and its opening."""
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
    with pytest.raises(CorruptError):
        FolderStorage(tmp_path / "folder").read("deep/file", 10)


def test_a_name_that_is_swapped_for_a_link_never_shows_what_it_leads_to(tmp_path: Path) -> None:
    """Another thread swaps the name as fast as it can while it is read."""
    (tmp_path / "secret").write_bytes(b"secret")
    (tmp_path / "away").mkdir()
    (tmp_path / "away" / "file").write_bytes(b"secret")
    folder = tmp_path / "folder"
    (folder / "deep").mkdir(parents=True)
    (folder / "deep" / "file").write_bytes(b"inside")
    stop = threading.Event()

    def swap() -> None:
        while not stop.is_set():
            (folder / "deep").rename(folder / "kept")
            (folder / "deep").symlink_to("../away")
            (folder / "deep").unlink()
            (folder / "kept").rename(folder / "deep")

    swapper = threading.Thread(target=swap)
    swapper.start()
    storage, outcomes = FolderStorage(folder), set[bytes | str]()
    try:
        end_s = time.monotonic() + 1.0
        while time.monotonic() < end_s:
            try:
                outcomes.add(storage.read("deep/file", 10))
            except CodecError as error:
                outcomes.add(str(error).rpartition("/")[2].partition(":")[0])
    finally:
        stop.set()
        swapper.join()
    assert b"inside" in outcomes
    assert len(outcomes) > 1, "nothing was swapped in time"
    assert b"secret" not in outcomes


def test_a_folder_that_is_gone_says_so(tmp_path: Path) -> None:
    storage = FolderStorage(tmp_path / "absent")
    with pytest.raises(CorruptError, match="is not a folder"):
        storage.check()
    with pytest.raises(FileNotFoundError):  # the error that a Python caller expects
        storage.check()
    (tmp_path / "file").touch()
    with pytest.raises(CorruptError, match="is not a folder") as told:
        FolderStorage(tmp_path / "file").check()
    assert not isinstance(told.value, OSError)
    with pytest.raises(UnreadableError, match=r"absent cannot be listed: No such file"):
        storage.folders(("m",))
    assert storage.stamp("m") is None


@pytest.mark.parametrize("name", ["manifest.json", "index.bin", "segments/1/0"])
@pytest.mark.parametrize("command", [summarise, verify_stream])
def test_no_command_waits_for_a_pipe(tmp_path: Path, name: str, command: object) -> None:
    assert callable(command)
    write_tiny(tmp_path / "s", 8)
    (tmp_path / "s" / name).unlink()
    os.mkfifo(tmp_path / "s" / name)
    if command is summarise and name.startswith("segments"):
        return  # it reads no object
    with pytest.raises(CorruptError, match=rf"{name} cannot be read: it is not a regular file"):
        command(tmp_path / "s")


def test_an_import_does_not_wait_for_a_pipe(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "x.ply")
    with pytest.raises(CorruptError, match=r"x\.ply cannot be read: it is not a regular file"):
        read_splats(tmp_path / "x.ply")
