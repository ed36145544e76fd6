"""/play for browsers over real sockets: its decoded body is the usual play, inflated."""

from __future__ import annotations

import gzip
import io
from dataclasses import replace
from pathlib import Path

import aiohttp
import pytest
import zstandard

from codec.coders.coder import decompress
from codec.stream.playrecord import Record, RecordParser, SliceRecord, SnapshotRecord
from codec.tools.static import export_static
from tests.support.server.running_server import make_stream, play, served
from tests.support.slots.slot_streams import write_busy_stream
from tests.support.slots.updates import small_layout

pytestmark = pytest.mark.anyio

MOST_BYTES = 1 << 20
QUERY = "?from=7&layers=2"


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("root")
    make_stream(folder / "slices", 23, fps=300)
    make_stream(folder / "long", 150, slice_size=500)
    write_busy_stream(folder / "slots", 20, small_layout(1, (40, 30, 30), 0, 5))
    export_static(folder / "slots", folder / "gzip")
    return folder


async def plain_body(client: aiohttp.ClientSession, stream: str, accepts: str) -> tuple[str, bytes]:
    """(Content-Encoding, body as sent) of a plain play."""
    headers = {"Accept-Encoding": accepts}
    url = f"/v1/streams/{stream}/play{QUERY}&plain=1"
    async with client.get(url, headers=headers, auto_decompress=False) as response:
        assert response.status == 200, await response.text()
        return response.headers.get("Content-Encoding", ""), await response.read()


def inflated(record: Record) -> Record:
    """`record` with the contents of its zstd packets."""

    def content(packet: bytes) -> bytes:
        is_zstd = packet.startswith(b"\x28\xb5\x2f\xfd")
        return decompress(packet, MOST_BYTES) if is_zstd else packet

    match record:
        case SliceRecord():
            mask = None if record.mask is None else content(record.mask)
            return replace(record, packets=tuple(map(content, record.packets)), mask=mask)
        case SnapshotRecord():
            return replace(record, packets=tuple(map(content, record.packets)))
        case _:
            return record


@pytest.mark.parametrize("stream", ["slices", "slots", "gzip"])
@pytest.mark.parametrize(
    ("accepts", "encoding"),
    [
        ("gzip, deflate, br, zstd", "zstd"),
        ("zstd;q=0.5", "zstd"),
        ("gzip, deflate", "gzip"),
        ("GZIP, zstd;q=0", "gzip"),
        ("identity, zstd; q=0.0", ""),
        ("gzip;q=0, *", ""),
    ],
)
async def test_the_body_is_what_others_get(
    root: Path, stream: str, accepts: str, encoding: str
) -> None:
    async with served(root) as (_, client):
        expected = [inflated(record) for record in await play(client, stream, QUERY)]
        found, body = await plain_body(client, stream, accepts)
        assert found == encoding
        if found == "gzip":
            body = gzip.decompress(body)
        elif found:
            frames = zstandard.ZstdDecompressor().stream_reader(
                io.BytesIO(body), read_across_frames=True
            )
            body = frames.read()
        assert RecordParser().feed(body) == expected
