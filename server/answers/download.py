"""A stream as one file, which `swings-stream pack` would write; packed while it is sent."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator

from aiohttp import web

from codec.errors import CorruptError
from codec.stream.packedlayout import PACKED_SUFFIX
from codec.stream.streampacker import StreamPacker
from server.html.watchpage import DOWNLOAD_NAME
from server.http.content import NO_STORE, OBJECT_TYPE
from server.http.errors import RequestError
from server.http.streaming import BodyWriter, stream
from server.library import ServedStream
from server.state.serverstate import STATE

from .asked import STREAM, check_room, place_of, stream_of

BLOCK_BYTES = 1 << 18
"""So many bytes at least are read, checked and written in one go."""

routes = web.RouteTableDef()


@routes.get(f"{STREAM}/{DOWNLOAD_NAME}")
async def download(request: web.Request) -> web.StreamResponse:
    state, packed = request.app[STATE], stream_of(request)
    if packed.live or not packed.num_frames:
        raise RequestError(404, f"{packed.name} can be downloaded when it is finished")
    # It takes the place of a play: what limits those limits this.
    check_room(state)
    with place_of(request):
        packer = await asyncio.to_thread(packed.packer)
        headers = {
            "Content-Type": OBJECT_TYPE,
            "Content-Disposition": f'attachment; filename="{packed.name}{PACKED_SUFFIX}"',
            "Accept-Ranges": "none",
            "Cache-Control": NO_STORE,
            "Content-Length": str(packer.layout.size_bytes),
        }
        if request.method == "HEAD":
            return web.Response(headers=headers)
        headers["X-Accel-Buffering"] = "no"  # nginx would take all of it to its disk

        async def send(writer: BodyWriter) -> None:
            writer.hold_at_most(state.config.send_queue_bytes)
            await _send(packed, packer, writer)

        return await stream(request, headers, send, state.count_sent)


async def _send(packed: ServedStream, packer: StreamPacker, writer: BodyWriter) -> None:
    """Writes the file. Raises a CodecError, which cuts the connection off, where it would not be
    whole."""
    pieces, left_bytes = packer.pieces(), packer.layout.size_bytes
    while left_bytes:
        block = await asyncio.to_thread(_next_block, pieces)
        if packed.gone or not block:
            raise CorruptError(f"{packed.name} was replaced or removed while it was downloaded")
        await writer.write(block)
        left_bytes -= len(block)


def _next_block(pieces: Iterator[bytes]) -> bytes:
    """The next pieces together; empty at the end."""
    block = bytearray()
    for piece in pieces:
        block += piece
        if len(block) >= BLOCK_BYTES:
            break
    return bytes(block)
