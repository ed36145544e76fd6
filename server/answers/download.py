"""A stream as one file, which `swings-stream pack` would write; packed while it is sent."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator

from codec.errors import CorruptError
from codec.stream.packedlayout import PACKED_SUFFIX
from codec.stream.streampacker import StreamPacker
from server.exchange.content import NO_STORE, OBJECT_TYPE
from server.exchange.errors import RequestError
from server.exchange.response import AnyResponse, BodyWriter, Response, StreamedResponse
from server.library import ServedStream

from .call import Call

BLOCK_BYTES = 1 << 18
"""So many bytes at least are read, checked and written in one go."""


async def download(call: Call) -> AnyResponse:
    stream = call.stream()
    if stream.live or not stream.num_frames:
        raise RequestError(404, f"{stream.name} can be downloaded when it is finished")
    # It takes the place of a play: what limits those limits this.
    call.check_room()
    call.take_place()
    is_sent = False
    try:
        packer = await asyncio.to_thread(stream.packer)
        is_sent = call.request.method == "GET"
    finally:
        if not is_sent:
            call.give_back_place()
    size_bytes = packer.layout.size_bytes
    fields = {
        "Content-Type": OBJECT_TYPE,
        "Content-Disposition": f'attachment; filename="{stream.name}{PACKED_SUFFIX}"',
        "Accept-Ranges": "none",
        "Cache-Control": NO_STORE,
    }
    if not is_sent:
        return Response(200, fields, length=size_bytes)
    fields["Content-Length"] = str(size_bytes)
    fields["X-Accel-Buffering"] = "no"  # nginx would take all of it to its disk

    # Nothing may wait before the body is made: its end gives the place back.
    async def send(writer: BodyWriter) -> None:
        try:
            await _send(call, stream, packer, writer)
        finally:
            call.give_back_place()

    return StreamedResponse(fields, send)


async def _send(call: Call, stream: ServedStream, packer: StreamPacker, writer: BodyWriter) -> None:
    """Writes the file. Raises a CodecError, which cuts the connection off, where it would not be
    whole."""
    writer.hold_at_most(call.state.config.send_queue_bytes)
    pieces, left_bytes = packer.pieces(), packer.layout.size_bytes
    while left_bytes:
        block = await asyncio.to_thread(_next_block, pieces)
        if stream.gone or not block:
            raise CorruptError(f"{stream.name} was replaced or removed while it was downloaded")
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
