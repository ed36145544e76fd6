"""Files are complete or absent, and reading one costs no more than allowed."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from codec.errors import CorruptError, InvalidError
from codec.files import append_durably, read_bounded, replacing, temporary_beside, write_atomic
from tests.support.hostile import file_limit


def test_a_file_is_replaced_whole(tmp_path: Path) -> None:
    path = tmp_path / "file"
    write_atomic(path, b"old")
    with replacing(path) as temporary:
        temporary.write_bytes(b"new")
        assert path.read_bytes() == b"old"
    assert path.read_bytes() == b"new"
    assert os.listdir(tmp_path) == ["file"]


@pytest.mark.parametrize("name", ["fsync", "replace", ""])
def test_what_fails_leaves_the_old_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    def failing(*_: object) -> None:
        raise OSError(28, "No space left on device")

    path = tmp_path / "file"
    write_atomic(path, b"old")
    if name:
        monkeypatch.setattr(os, name, failing)

    def replace() -> None:
        with replacing(path) as temporary:
            temporary.write_bytes(b"half")
            if not name:
                failing()

    with pytest.raises(OSError, match="No space"):
        replace()
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
    (tmp_path / "folder").mkdir()
    for name, message in (
        ("file", "file is longer than 9 bytes"),
        ("folder", r"folder cannot be read: Is a directory$"),
        ("x", r"x is missing; take another$"),
    ):
        with pytest.raises(CorruptError, match=message):
            read_bounded(tmp_path / name, 9, if_missing="take another")
    with pytest.raises(CorruptError, match=r"x is missing$"):
        read_bounded(tmp_path / "x", 9)


def test_a_full_disk_names_the_file(tmp_path: Path) -> None:
    with file_limit(1000), pytest.raises(OSError, match=r"File too large: '.*/file'"):
        write_atomic(tmp_path / "file", bytes(2000))
    with pytest.raises(OSError, match=r"No such file or directory: '.*/absent/file'"):
        write_atomic(tmp_path / "absent" / "file", b"")
    assert os.listdir(tmp_path) == []
