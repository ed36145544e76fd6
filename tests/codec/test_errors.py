"""Errors keep their kind and their place however often they are raised again."""

from __future__ import annotations

from pathlib import Path

import pytest

from codec.errors import CodecError, CorruptError, MissingFolderError, UnsupportedError

ROOT = Path(__file__).parents[2]


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


def test_an_error_of_a_part_is_moved_to_its_place_in_the_whole() -> None:
    assert CorruptError("x", 3).moved(10).at == 13
    assert CorruptError("x").moved(10).at is None


def test_only_the_errors_themselves_make_an_error_of_another() -> None:
    """`type(error)(...)` loses the place; `within`, `moved` and `reworded` keep it."""
    folders = ("codec", "trainer", "server", "player", "bench", "fuzz")
    files = [file for folder in folders for file in sorted((ROOT / folder).rglob("*.py"))]
    assert len(files) > 100
    for file in files:
        if file != ROOT / "codec" / "errors.py":
            assert "type(error)(" not in file.read_text(encoding="utf-8"), file
