"""Files are complete or absent, and reading one costs no more than allowed."""

from __future__ import annotations

import os
import resource
from collections.abc import Callable
from pathlib import Path

import pytest

from codec.errors import CorruptError, InvalidError
from codec.files import append_durably, read_bounded, replacing, temporary_beside, write_atomic


def test_a_file_is_replaced_whole(tmp_path: Path) -> None:
    path = tmp_path / "file"
    write_atomic(path, b"old")
    with replacing(path) as temporary:
        temporary.write_bytes(b"new")
        assert path.read_bytes() == b"old"
    assert path.read_bytes() == b"new"
    assert os.listdir(tmp_path) == ["file"]


def write_half(path: Path) -> None:
    with replacing(path) as temporary:
        temporary.write_bytes(b"half")
        raise ZeroDivisionError


def test_what_fails_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "file"
    write_atomic(path, b"old")
    with pytest.raises(ZeroDivisionError):
        write_half(path)
    assert path.read_bytes() == b"old"
    assert os.listdir(tmp_path) == ["file"]


@pytest.mark.parametrize("name", ["fsync", "replace"])
def test_a_disk_that_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    def failing(*_: object) -> None:
        raise OSError(28, "No space left on device")

    path = tmp_path / "file"
    write_atomic(path, b"old")
    monkeypatch.setattr(os, name, failing)
    with pytest.raises(OSError, match="No space"):
        write_atomic(path, b"new")
    assert path.read_bytes() == b"old"
    assert os.listdir(tmp_path) == ["file"]


@pytest.mark.parametrize("path", [Path("/"), Path()])
def test_what_has_no_name_cannot_be_written(path: Path) -> None:
    with pytest.raises(InvalidError, match="names no file or folder"):
        temporary_beside(path)


def test_appending_cuts_off_what_nobody_knows_of(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"known, torn")
    append_durably(path, 5, b" and more")
    assert path.read_bytes() == b"known and more"
    with pytest.raises(CorruptError, match=r"file has 14 bytes, not the 15 written"):
        append_durably(path, 15, b"x")
    assert path.read_bytes() == b"known and more"


def test_a_file_is_read_up_to_a_limit(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"0123456789")
    assert read_bounded(path, 10) == b"0123456789"
    assert read_bounded(path, 3, 7) == b"789"
    assert read_bounded(path, 0, 99) == b""
    with pytest.raises(CorruptError, match="file is longer than 9 bytes"):
        read_bounded(path, 9)


CANNOT: dict[str, tuple[Callable[[Path], object], str]] = {
    "folder": (lambda path: path.mkdir(), r"x cannot be read: Is a directory$"),
    "absent": (lambda path: None, r"x is missing$"),
}


@pytest.mark.parametrize("what", CANNOT)
def test_what_cannot_be_read_is_named(tmp_path: Path, what: str) -> None:
    make, message = CANNOT[what]
    make(tmp_path / "x")
    with pytest.raises(CorruptError, match=message):
        read_bounded(tmp_path / "x", 9)


def test_what_it_means_that_a_file_is_missing_is_said(tmp_path: Path) -> None:
    with pytest.raises(CorruptError, match=r"x is missing; take another$"):
        read_bounded(tmp_path / "x", 9, if_missing="take another")


def test_a_full_disk_names_the_file(tmp_path: Path) -> None:
    path = tmp_path / "file"
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, hard))
    try:
        with pytest.raises(OSError, match=r"File too large: '.*/file'"):
            write_atomic(path, bytes(2000))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    with pytest.raises(OSError, match=r"No such file or directory: '.*/absent/file'"):
        write_atomic(tmp_path / "absent" / "file", b"")
    assert os.listdir(tmp_path) == []
