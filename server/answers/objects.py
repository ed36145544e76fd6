"""A stream's files over HTTP, under the same relative paths as on disk; and the stream as one file,
which `swings-stream pack` would write, packed while it is sent.
"""

from __future__ import annotations

import asyncio
import hashlib
from collections.abc import Iterator

from aiohttp import web

from codec.errors import CorruptError
from codec.stream.captions import CAPTIONS_TYPE
from codec.stream.integrity import MAX_INDEX_BYTES
from codec.stream.manifest import MANIFEST_NAME, SKIP_MAPS, Part
from codec.stream.packedlayout import PACKED_SUFFIX
from codec.stream.pictures import picture_type
from codec.stream.segment import INDEX_NAME
from codec.stream.sound import SOUND_NAME, SOUND_PREFIX
from server.html.htmlpages import DOWNLOAD_NAME
from server.http.content import (
    IMMUTABLE,
    NO_STORE,
    OBJECT_TYPE,
    REVALIDATE,
    Content,
    StreamedResponse,
    serve,
)
from server.http.errors import RequestError
from server.http.requestlog import FACTS
from server.state.serverstate import STATE

from .asked import STREAM, parse_number, room_for_play, stream_of, waits

MAX_WAIT_S = 30
"""Seconds that a client may wait for an index to grow."""

_NUMBER = "0|[1-9][0-9]{0,8}"

_PART = f"{_NUMBER}|{SKIP_MAPS}|keyframe-(?:{_NUMBER})|{SOUND_PREFIX}{SOUND_NAME}"
"""What a segment has an object of; which of them there are, the stream says."""

routes = web.RouteTableDef()

last_routes = web.RouteTableDef()
"""The routes that others go before: a name in them may be nearly anything."""


@routes.get(f"{STREAM}/segments/{{segment:{_NUMBER}}}/{{layer:{_PART}}}")
async def segment_object(request: web.Request) -> web.StreamResponse:
    state, stream = request.app[STATE], stream_of(request)
    segment, name = int(request.match_info["segment"]), request.match_info["layer"]
    part: Part = int(name) if name.isdigit() else name
    content = state.cache.content(stream, segment, part)
    if content is None:
        waits(request)
        if stream.has_sound(segment, name):
            # Another may take its name, so whoever keeps it asks again.
            content = await state.cache.load_sound(stream, segment, name)
        elif stream.has_object(segment, part):
            content = await state.cache.load(stream, segment, part)
        else:
            raise RequestError(404, f"{stream.name} has no segment {segment} layer {name}")
    return await serve(request, content)


@routes.get(f"{STREAM}/{MANIFEST_NAME}")
async def manifest(request: web.Request) -> web.StreamResponse:
    view = stream_of(request).view
    content = Content(view.manifest_json, view.manifest_sha256, "application/json", REVALIDATE)
    return await serve(request, content)


@routes.get(f"{STREAM}/{INDEX_NAME}")
async def index(request: web.Request) -> web.StreamResponse:
    """The index; with ?after=N and &wait=S once it has more than N bytes, or after S seconds."""
    stream, stopping = stream_of(request), request.app[STATE].stopping
    # Other keys, such as one that gets past a cache of another server, are passed over.
    after_bytes = parse_number("after", request.query.get("after", "0"), MAX_INDEX_BYTES)
    wait_s = parse_number("wait", request.query.get("wait", "0"), MAX_WAIT_S)
    clock, num_segments = asyncio.get_running_loop().time, stream.view.num_segments
    until_s = clock() + wait_s
    while (
        len(stream.view.index_data) <= after_bytes
        and stream.live
        and not stream.gone
        and not stopping.is_set()
        and stream.view.num_segments == num_segments
        and clock() < until_s
        and request.transport is not None
    ):
        # Not all at once: the server may stop meanwhile.
        await stream.wait_for_growth(num_segments, min(0.5, until_s - clock()))
    view = stream_of(request).view
    content = Content(view.index_data, view.index_sha256, OBJECT_TYPE, REVALIDATE)
    return await serve(request, content)


@routes.get("/web/{asset:.+}")
async def web_asset(request: web.Request) -> web.StreamResponse:
    """A file of the browser player."""
    name = request.match_info["asset"]
    asset = request.app[STATE].web_player.assets.get(name)
    if asset is None:
        raise RequestError(404, f"the browser player has no file {name[:80]!a}")
    caching = IMMUTABLE if asset.immutable else REVALIDATE
    content = Content(asset.data, asset.sha256, asset.content_type, caching, asset.coded)
    return await serve(request, content)


@last_routes.get(STREAM + r"/{picture:.+\.[A-Za-z]{3,4}}")
async def picture(request: web.Request) -> web.StreamResponse:
    """The pictures and captions that the manifest names, and no other file."""
    stream, name = stream_of(request), request.match_info["picture"]
    content_type = CAPTIONS_TYPE if name.endswith(".vtt") else picture_type(name)
    data = None
    if content_type is not None:
        waits(request)
        read = stream.read_captions if content_type is CAPTIONS_TYPE else stream.read_picture
        data = await asyncio.to_thread(read, name)
    if data is None or content_type is None:
        what = "captions" if content_type is CAPTIONS_TYPE else "picture"
        raise RequestError(404, f"{stream.name} has no {what} {name[:80]!a}")
    sha256 = hashlib.sha256(data).hexdigest()
    return await serve(request, Content(data, sha256, content_type, REVALIDATE))


BLOCK_BYTES = 1 << 18
"""So many bytes at least are read, checked and written in one go."""


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
