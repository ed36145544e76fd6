"""A stream on a static host, or in a folder: an error names the URL, or the file, and the byte."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from codec.errors import CorruptError
from codec.stream import StreamReader
from tests.support.delivery.assembled import read_all
from tests.support.hosted_streams import static_host, write_stream
from tests.support.hostile import put_object


@pytest.fixture
def stream(tmp_path: Path) -> Path:
    return write_stream(tmp_path / "s", 13)


def told(stream: Path) -> tuple[str, int | None]:
    """Message, from the folder on, and place of the error when playing `stream` from a host."""
    with static_host(stream.parent) as host, pytest.raises(CorruptError) as caught:
        read_all(f"{host}/s")
    message = str(caught.value)
    assert message.startswith(f"{host}/s/")
    return message.removeprefix(f"{host}/s/"), caught.value.at


def test_a_wrong_record_of_the_index(stream: Path) -> None:
    index = bytearray((stream / "index.bin").read_bytes())
    size = len(index) // 3
    index[size + 20] ^= 1
    (stream / "index.bin").write_bytes(index)
    message, at = told(stream)
    assert at == size
    assert message.startswith(f"index.bin: byte {size}: index: the record of segment 1")


def test_a_wrong_table_and_a_wrong_chunk(stream: Path) -> None:
    # Another segment's table has other births; another layer's chunks are behind a right one.
    manifest = StreamReader(stream).manifest
    elsewhere = replace(manifest, object_url="https://cdn.example/{layer}/{segment}")
    for other, place, what in (("0/0", 20, "object"), ("1/1", 20 + 5 * 12, "change")):
        put_object(stream, 1, 0, (stream / "segments" / other).read_bytes())
        message, at = told(stream)
        assert at == place
        assert message.startswith(f"segments/1/0: byte {place}: {what}: ")
        # From the folder, whose objects have other URLs.
        (stream / "manifest.json").write_bytes(elsewhere.to_json())
        with pytest.raises(CorruptError) as caught:
            read_all(str(stream))
        assert str(caught.value) == f"{stream}/{message}"
        assert caught.value.at == place
        (stream / "manifest.json").write_bytes(manifest.to_json())
