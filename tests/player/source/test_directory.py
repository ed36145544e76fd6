"""A stream directory as a source: an error names the file that was read."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from codec.errors import CorruptError
from codec.stream import StreamReader
from player.source.opener import opened
from tests.support.delivery.assembled import assembled
from tests.support.hosted_streams import write_stream
from tests.support.hostile import put_object


@pytest.mark.parametrize("wrong", [("1", "1"), ("0", "0")], ids=["layer", "segment"])
def test_a_wrong_object_is_named_by_its_file_not_by_its_url(
    tmp_path: Path, wrong: tuple[str, str]
) -> None:
    """The index has the right size and hash of it: what is wrong is a chunk, or the table."""
    stream = write_stream(tmp_path / "s", 13)
    manifest = StreamReader(stream).manifest
    elsewhere = replace(manifest, object_url="https://cdn.example/{layer}/{segment}")
    (stream / "manifest.json").write_bytes(elsewhere.to_json())
    put_object(stream, 1, 0, stream.joinpath("segments", *wrong).read_bytes())
    with opened(str(stream)) as source, pytest.raises(CorruptError) as caught:
        list(assembled(source))
    assert str(caught.value).startswith(f"{stream / 'segments' / '1' / '0'}: byte ")
    assert "cdn.example" not in str(caught.value)
    assert caught.value.at is not None
