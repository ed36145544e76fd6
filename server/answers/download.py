"""A stream as one file, which `swings-stream pack` would write; packed while it is sent."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator

from aiohttp import web

from codec.errors import CorruptError
from codec.stream.packedlayout import PACKED_SUFFIX
from server.html.watchpage import DOWNLOAD_NAME
from server.http.content import NO_STORE, OBJECT_TYPE
from server.http.errors import RequestError
from server.http.requestlog import FACTS
from server.http.streaming import StreamedResponse
from server.state.serverstate import STATE

from .asked import STREAM, room_for_play, stream_of

BLOCK_BYTES = 1 << 18
"""So many bytes at least are read, checked and written in one go."""

routes = web.RouteTableDef()


@routes.get(f"{STREAM}/{DOWNLOAD_NAME}")
async def download(request: web.Request) -> web.StreamResponse:
    state, packed = request.app[STATE], stream_of(request)
    if packed.live or not packed.num_frames:
        raise RequestError(404, f"{packed.name} can be downloaded when it is finished")
    # It takes the place of a play: what limits those limits this.
    with room_for_play(request):
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

        request[FACTS] = {}
        response = StreamedResponse(request, headers, state.count_sent)
        response.connection.hold_at_most(state.config.send_queue_bytes)
        pieces, left_bytes = packer.pieces(), packer.layout.size_bytes
        while left_bytes:
            block = await asyncio.to_thread(_next_block, pieces)
            if packed.gone or not block:  # the connection is cut off, as the file is not whole
                raise CorruptError(f"{packed.name} was replaced or removed while it was downloaded")
            await response.write(block)
            left_bytes -= len(block)
        return await response.end()


def _next_block(pieces: Iterator[bytes]) -> bytes:
    """The next pieces together; empty at the end."""
    block = bytearray()
    for piece in pieces:
        block += piece
        if len(block) >= BLOCK_BYTES:
            break
    return bytes(block)
