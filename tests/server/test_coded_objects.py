"""Objects as `Content-Encoding: zstd`: the stored bytes, and a client that inflates them."""

from __future__ import annotations

from pathlib import Path

import aiohttp
import pytest
import zstandard

from codec.coders import gzip
from codec.stream import StreamReader
from codec.stream.manifest import Part
from codec.stream.object import ChunkEntry, packet_content
from codec.stream.plainrecord import inflates_whole
from tests.support.server.running_server import Answer, fetch, make_stream, running
from tests.support.slots.slot_streams import write_slot_stream
from tests.support.slots.updates import small_layout

pytestmark = pytest.mark.anyio

URL = "/v1/streams/walk/segments/0/1"
ZSTD = {"Accept_Encoding": "gzip, deflate, br, zstd"}
NONE = {"Accept_Encoding": "identity"}


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("root")
    make_stream(root / "walk", 12, slice_size=500)
    write_slot_stream(root / "slots", 13, small_layout(3, (6, 4, 5), 0, 5))
    return root


def inflated(data: bytes) -> bytes:
    """The content of all frames of `data`, inflated like in a browser."""
    with zstandard.ZstdDecompressor().stream_reader(data, read_across_frames=True) as reader:
        return reader.read()


def contents(folder: Path, segment: int, part: Part) -> bytes:
    """The contents of the packets, one after the other."""
    found = StreamReader(folder).read_object(segment, part)
    packets = [found.data[one.offset : one.offset + one.size] for one in found.entries]
    return b"".join(packet_content(packet, 1 << 24) for packet in packets)


async def each_way(
    port: int, url: str, method: str = "GET", **fields: str
) -> tuple[Answer, Answer]:
    """The plain and the coded response, from a client that decodes nothing."""
    async with aiohttp.ClientSession(f"http://127.0.0.1:{port}", auto_decompress=False) as client:
        plain = await fetch(client, url, method, **NONE, **fields)
        return plain, await fetch(client, url, method, **ZSTD, **fields)


async def test_its_frames_hold_the_contents_of_its_packets(root: Path) -> None:
    async with running(root) as server:
        urls = [
            (f"/v1/streams/{name}/segments/{segment}/{part}", root / name, segment, part)
            for name in ("walk", "slots")
            for segment in range(2)
            for part in StreamReader(root / name).manifest.parts
        ]
        assert len(urls) > 12
        for url, folder, segment, part in urls:
            for _ in range(2):  # read from disk, and from memory
                plain, coded = await each_way(server.port, url)
                stored = (folder / "segments" / url.split("segments/")[1]).read_bytes()
                assert plain.body == coded.body == stored
                assert "Content-Encoding" not in plain.headers
                assert coded.headers["Content-Encoding"] == "zstd"
                assert inflated(coded.body) == contents(folder, segment, part)
                assert plain.headers["ETag"] != coded.headers["ETag"]
                assert plain.headers["Vary"] == coded.headers["Vary"] == "Accept-Encoding"


async def test_each_form_is_revalidated_with_its_own_tag(root: Path) -> None:
    async with running(root) as server:
        for method in ("HEAD", "GET", "HEAD"):  # HEAD before it was read, and after
            plain, coded = await each_way(server.port, URL, method)
            tags = plain.headers["ETag"], coded.headers["ETag"]
            assert tags[0] != tags[1]
            for n, tag in enumerate(tags):
                got = await each_way(server.port, URL, method, If_None_Match=tag)
                assert [one.status for one in got] == [304 if m == n else 200 for m in (0, 1)]
                got = await each_way(server.port, URL, method, If_Match=tag)
                assert [one.status for one in got] == [200 if m == n else 412 for m in (0, 1)]


async def test_what_is_not_an_object_is_never_coded(root: Path) -> None:
    async with running(root) as server:
        for url in ("/v1/streams/walk/manifest.json", "/v1/streams/walk/index.bin"):
            plain, coded = await each_way(server.port, url)
            assert "Content-Encoding" not in coded.headers
            assert plain.headers["ETag"] == coded.headers["ETag"]
            assert plain.body == coded.body


def test_an_object_is_one_zstd_stream_or_not() -> None:
    packet, empty = zstandard.compress(b"something"), ChunkEntry(0, 0, 0)
    some = ChunkEntry(1, 0, len(packet))
    assert inflates_whole(packet, [empty, some])  # a packet of no bytes is part of any stream
    assert inflates_whole(b"", [])
    other = gzip.compress(b"something")
    assert not inflates_whole(packet + other, [some, ChunkEntry(2, len(packet), len(other))])
    wide = zstandard.ZstdCompressionParameters(window_log=24)
    packet = zstandard.ZstdCompressor(compression_params=wide).compress(bytes(1 << 25))
    assert not inflates_whole(packet, [ChunkEntry(0, 0, len(packet))])  # browsers refuse it
