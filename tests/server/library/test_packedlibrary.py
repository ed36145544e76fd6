"""Packed streams among the served streams: found, followed, and refused by name."""

from __future__ import annotations

import asyncio
import json
import shutil
from pathlib import Path
from urllib.error import HTTPError
from urllib.request import Request, urlopen

import pytest

from codec.stream.captions import Captions
from codec.stream.reader import StreamReader
from codec.stream.streampacker import pack_stream, unpack_stream
from codec.tracks.streamtracks import add_captions
from server.library import Library
from tests.support.hosted_streams import served, write_stream
from tests.support.server.running_server import live_stream
from tests.support.sounding import add_clicks
from tests.support.stores.s3_server import BUCKET, S3Server
from tests.support.tiny_stream import files_of
from tests.support.waiting import BOUND_S


@pytest.fixture(scope="module")
def stream(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A stream with sound and captions."""
    stream = write_stream(tmp_path_factory.mktemp("made") / "s", 13)
    add_clicks(stream, (0, 6))
    (stream.parent / "in.vtt").write_text("WEBVTT\n\n00:00.000 --> 00:01.000\nHere\n")
    add_captions(stream, stream.parent / "in.vtt", Captions("en", "English"))
    return stream


def look(library: Library) -> None:
    asyncio.run(library.look())


def fetch(url: str, **fields: str) -> tuple[int, bytes]:
    try:
        with urlopen(Request(url, headers=fields), timeout=BOUND_S) as response:
            return response.status, response.read()
    except HTTPError as error:
        return error.code, error.read()


@pytest.mark.parametrize("is_root", [False, True])
def test_a_packed_stream_is_served_like_its_folder(
    stream: Path, tmp_path: Path, is_root: bool
) -> None:
    """Every file has the same URL, bytes and tags, whole and in part."""
    pack_stream(stream, tmp_path / "talk.swings")
    with served(tmp_path / "talk.swings" if is_root else tmp_path) as server:
        base = f"{server.url}/v1/streams/talk"
        listed = json.loads(fetch(f"{server.url}/v1/streams")[1])["streams"]
        assert [one["name"] for one in listed] == ["talk"]
        for path, data in files_of(stream).items():
            assert fetch(f"{base}/{path}") == (200, data), path
            assert fetch(f"{base}/{path}", Range="bytes=3-9") == (206, data[3:10]), path
        for name in ("segments/9/0", "segments/0/audio-other", "captions-fr.vtt", ".tracks"):
            assert fetch(f"{base}/{name}")[0] == 404
        assert fetch(f"{server.url}/watch/talk")[0] == 200
        assert fetch(f"{base}/stream.swings") == (200, (tmp_path / "talk.swings").read_bytes())


def test_a_stream_is_downloaded_as_one_file(stream: Path, tmp_path: Path) -> None:
    """Whole as `swings-stream pack` writes it, or broken off; and only if it is finished."""
    root, packed = tmp_path / "root", tmp_path / "s.swings"
    shutil.copytree(stream, root / "s")
    pack_stream(stream, packed)
    live_stream(root / "live", 8)
    with served(root) as server:
        url = f"{server.url}/v1/streams/s/stream.swings"
        with urlopen(Request(url, method="HEAD"), timeout=BOUND_S) as response:
            assert response.headers["Content-Length"] == str(packed.stat().st_size)
        assert fetch(url) == (200, packed.read_bytes())
        assert fetch(f"{server.url}/v1/streams/live/stream.swings")[0] == 404
        damaged = root / "s" / "segments" / "2" / "0"
        damaged.write_bytes(damaged.read_bytes()[::-1])
        assert fetch(url)[0] == 500  # of one that is larger, a part would have been sent


def test_a_folder_comes_before_a_file_of_its_name(stream: Path, tmp_path: Path) -> None:
    packed = tmp_path / "s.swings"
    pack_stream(stream, packed)
    unpack_stream(packed, tmp_path / "s")
    pack_stream(stream, tmp_path / "two words.swings")
    pack_stream(stream, tmp_path / ".hidden.swings")
    library = Library(tmp_path, 1.0)
    assert list(library.streams) == ["s"]
    assert library.broken.pop("s.swings").startswith("there is a folder with the name")
    assert library.broken.pop("two words").startswith("the name of a stream's folder")
    assert library.broken == {}


def test_a_file_that_is_replaced_is_another_stream(stream: Path, tmp_path: Path) -> None:
    packed = tmp_path / "root" / "s.swings"
    packed.parent.mkdir()
    packed.write_bytes(b"PK\x03\x04 not yet")
    library = Library(packed.parent, 1.0)
    assert library.streams == {}
    assert library.broken == {"s": "byte 12: packed stream: 12 bytes are too few"}
    pack_stream(stream, packed)
    look(library)
    first = library.streams["s"]
    expected = StreamReader(stream).read_object(1, 0).data
    assert first.read_object(1, 0).data == expected
    # The same bytes are the same stream, so that its plays continue.
    pack_stream(stream, packed)
    look(library)
    assert library.streams["s"] is first
    write_stream(tmp_path / "other", 21)
    pack_stream(tmp_path / "other", packed)
    look(library)
    assert first.gone
    assert library.streams["s"].num_frames == 21
    # Unpacked, under the same name.
    packed.rename(tmp_path / "aside.swings")
    unpack_stream(tmp_path / "aside.swings", packed.parent / "s")
    look(library)
    assert library.streams["s"].num_frames == 21
    assert library.streams["s"].read_object(2, "skipmaps").data
    packed.parent.joinpath("s").rename(tmp_path / "gone")
    look(library)
    assert (library.streams, library.broken) == ({}, {})


def test_packed_streams_of_an_object_store(stream: Path, s3: S3Server, tmp_path: Path) -> None:
    pack_stream(stream, tmp_path / "s.swings")
    s3.put("place/s.swings", (tmp_path / "s.swings").read_bytes())
    for root in (f"s3://{BUCKET}/place", f"s3://{BUCKET}/place/s.swings"):
        library = Library(root, 1.0)
        assert list(library.streams) == ["s"], library.broken
        for part in (0, "skipmaps", "keyframe-1"):
            read = library.streams["s"].read_object(2, part).data
            assert read == (stream / "segments" / "2" / str(part)).read_bytes()
