"""Files that are complete or absent, errors with a place, frame ranges, deferred signals."""

from __future__ import annotations

import io
import os
import signal
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from codec.errors import (
    CodecError,
    CorruptError,
    InvalidError,
    MissingFolderError,
    UnsupportedError,
)
from codec.files import append_durably, read_bounded, replacing, temporary_beside, write_atomic
from codec.framerange import FrameRange
from codec.interrupts import postponed_interrupts
from tests.support.hostile import file_limit, refused


def test_a_file_is_replaced_whole(tmp_path: Path) -> None:
    path = tmp_path / "file"
    write_atomic(path, b"old")
    with replacing(path) as temporary:
        temporary.write_bytes(b"new")
        assert path.read_bytes() == b"old"
    assert path.read_bytes() == b"new"
    assert os.listdir(tmp_path) == ["file"]


@pytest.mark.parametrize("name", ["fsync", "replace", ""])
def test_what_fails_is_not_seen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
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

    refused(OSError, "No space", replace)
    assert path.read_bytes() == b"old"
    assert os.listdir(tmp_path) == ["file"]


@pytest.mark.parametrize("path", [Path("/"), Path()])
def test_what_has_no_name_cannot_be_written(path: Path) -> None:
    refused(InvalidError, "names no file or folder", temporary_beside, path)


def test_appending_cuts_off_what_nobody_knows_of(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"known, torn")
    append_durably(path, 5, b" and more")
    assert path.read_bytes() == b"known and more"
    refused(CorruptError, r"file has 14 bytes, not the 15 written", append_durably, path, 15, b"x")
    assert path.read_bytes() == b"known and more"


def test_an_append_is_whole_or_taken_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "file"
    path.write_bytes(bytes(100))
    for room_bytes in (0, 1, 19):
        with file_limit(100 + room_bytes):
            refused(OSError, "File too large: '.*/file'", append_durably, path, 100, b"x" * 20)
        assert path.read_bytes() == bytes(100)

    class Grudging(io.FileIO):
        """A file that accepts only a few bytes per write, which is no failure."""

        def write(self, data: Any) -> int:
            return super().write(data[:7])

    monkeypatch.setattr("codec.files.open", lambda *a, **_: Grudging(*a), raising=False)
    append_durably(path, 100, b"0123456789" * 3)
    assert path.read_bytes() == bytes(100) + b"0123456789" * 3


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
        refused(CorruptError, message, read_bounded, tmp_path / name, 9, if_missing="take another")
    refused(CorruptError, r"x is missing$", read_bounded, tmp_path / "x", 9)


def test_a_full_disk_names_the_file(tmp_path: Path) -> None:
    with file_limit(1000), pytest.raises(OSError, match=r"File too large: '.*/file'"):
        write_atomic(tmp_path / "file", bytes(2000))
    with pytest.raises(OSError, match=r"No such file or directory: '.*/absent/file'"):
        write_atomic(tmp_path / "absent" / "file", b"")
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("kind", [CorruptError, MissingFolderError, UnsupportedError])
def test_an_error_within_a_file_names_it_and_the_byte(kind: type[CodecError]) -> None:
    told = kind("chunk: version 9", 4).within("segments/0/1", 100)
    assert (type(told), str(told), told.at) == (
        kind,
        "segments/0/1: byte 104: chunk: version 9",
        104,
    )
    told = kind("it was altered").within("segments/0/1", 100)
    assert (type(told), str(told), told.at) == (kind, "segments/0/1: it was altered", None)
    assert CorruptError("x", 3).moved(10).at == 13  # of a part, to its place in the whole
    assert CorruptError("x").moved(10).at is None


@given(st.builds(FrameRange, st.integers(0, 99), st.none() | st.integers(100, 999)))
def test_text_and_range_are_the_same(frames: FrameRange) -> None:
    assert FrameRange.parse(str(frames)) == frames


@pytest.mark.parametrize(
    ("text", "frames"),
    [("3:7", range(3, 7)), (":", range(10)), ("5:", range(5, 10)), ("5:60", range(5, 10))],
)
def test_the_frames_of_a_capture(
    text: str, frames: range, caplog: pytest.LogCaptureFixture
) -> None:
    assert FrameRange.parse(text).of(10, "it") == frames
    said = "frames 5:60: it has frames 0:10; 5:10 are taken"
    assert caplog.messages == [said] * (text == "5:60")
    assert FrameRange.parse(":9").count == 9
    assert FrameRange.parse("4:").count is None


@pytest.mark.parametrize("text", ["10:", "12:14"])
def test_ranges_that_are_refused(text: str) -> None:
    refused(InvalidError, f"frames {text}: it has frames 0:10", FrameRange.parse(text).of, 10, "it")
    for frames, count in ((FrameRange(), 0), (FrameRange(-1, 0), 10)):
        refused(InvalidError, f"has frames 0:{count}", frames.of, count, "it")
    for wrong in ("", "5", "9:3", "3:3", "a:b", "-1:4", "1:2:3", "\u0663:", "5" * 5000 + ":"):
        assert len(str(refused(InvalidError, "frames", FrameRange.parse, wrong))) < 200


@pytest.mark.parametrize("times", [1, 2])
def test_the_first_signal_waits_and_the_second_does_not(times: int) -> None:
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    done: list[int] = []

    def interrupted() -> None:
        with postponed_interrupts():
            for number in range(times):
                signal.raise_signal(signal.SIGTERM)
                done.append(number)

    try:
        refused(KeyboardInterrupt, "", interrupted)
        assert done == [0]
        assert signal.getsignal(signal.SIGTERM) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGTERM, before)


def test_an_ignored_signal_stays_ignored() -> None:
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with postponed_interrupts():
            signal.raise_signal(signal.SIGINT)
    finally:
        signal.signal(signal.SIGINT, before)


def test_a_signal_is_not_lost_to_an_error_of_the_block() -> None:
    def failing() -> None:
        with postponed_interrupts():
            signal.raise_signal(signal.SIGINT)
            raise OSError("no space")

    refused(KeyboardInterrupt, "", failing)
