"""A stream's files over HTTP, under the same relative paths as on disk.

Rule: a strong ETag is a hash of the content, so equal tags mean equal bytes on every server.
"""

from __future__ import annotations

import asyncio
import hashlib
from collections.abc import Awaitable, Callable
from dataclasses import dataclass

from aiohttp import web

from codec.stream.manifest import Part
from codec.stream.poster import picture_type

from .byterange import ByteRange, Unsatisfiable, parse_range
from .client.connection import PIECE_BYTES, Connection
from .errors import RequestError
from .state import STATE, find_stream

IMMUTABLE = "public, max-age=31536000, immutable"
"""For objects: what a segment's URL gives never changes."""

REVALIDATE = "no-cache"
"""For what may change, manifest, index and poster: a cache asks each time and gets a 304."""


@dataclass(frozen=True, slots=True)
class Content:
    """What a URL stands for, before it is known which bytes of it are wanted."""

    size: int
    sha256: str
    content_type: str
    cache_control: str
    read: Callable[[int, int], Awaitable[bytes | memoryview]]
    """Gives bytes start..stop-1."""


async def manifest(request: web.Request) -> web.StreamResponse:
    view = (await find_stream(request)).view

    async def read(start: int, stop: int) -> bytes:
        return view.manifest_json[start:stop]

    size = len(view.manifest_json)
    content = Content(size, view.manifest_sha256, "application/json", REVALIDATE, read)
    return await _send(request, content)


async def index(request: web.Request) -> web.StreamResponse:
    view = (await find_stream(request)).view

    async def read(start: int, stop: int) -> bytes:
        return view.index_data[start:stop]

    content = Content(
        view.index_bytes, view.index_sha256, "application/octet-stream", REVALIDATE, read
    )
    return await _send(request, content)


async def segment_object(request: web.Request) -> web.StreamResponse:
    state = request.app[STATE]
    segment, name = int(request.match_info["segment"]), request.match_info["layer"]
    part: Part = int(name) if name.isdigit() else name
    stream = state.library.streams.get(request.match_info["stream"])
    # What the view has never changes; only for what it lacks is a look at the disk worth its time.
    if stream is None or not stream.has_object(segment, part):
        stream = await find_stream(request)
    if not stream.has_object(segment, part):
        raise RequestError(404, f"{stream.name} has no segment {segment} layer {name}")

    async def read(start: int, stop: int) -> memoryview:
        loaded = await state.cache.load(stream, segment, part)
        # The stream has this part, so the label is one of its parts.
        state.metrics.layer_bytes.add(stop - start, "object", name)
        return memoryview(loaded.data)[start:stop]

    content = Content(
        stream.object_bytes(segment, part),
        stream.object_sha256(segment, part),
        "application/octet-stream",
        IMMUTABLE,
        read,
    )
    return await _send(request, content)


async def web_asset(request: web.Request) -> web.StreamResponse:
    """A file of the browser player."""
    name = request.match_info["asset"]
    asset = request.app[STATE].web_player.assets.get(name)
    if asset is None:
        raise RequestError(404, f"the browser player has no file {name[:80]!r}")

    async def read(start: int, stop: int) -> bytes:
        return asset.data[start:stop]

    size = len(asset.data)
    return await _send(request, Content(size, asset.sha256, asset.content_type, REVALIDATE, read))


async def poster(request: web.Request) -> web.StreamResponse:
    """The picture that the manifest names, and no other file."""
    stream, name = await find_stream(request), request.match_info["poster"]
    content_type = picture_type(name)
    data = None
    if content_type is not None and name == stream.view.manifest.poster:
        data = await asyncio.to_thread(stream.read_poster)
    if data is None or content_type is None:
        raise RequestError(404, f"{stream.name} has no picture {name[:80]!r}")
    picture = data

    async def read(start: int, stop: int) -> bytes:
        return picture[start:stop]

    sha256 = hashlib.sha256(picture).hexdigest()
    return await _send(request, Content(len(picture), sha256, content_type, REVALIDATE, read))


async def _send(request: web.Request, content: Content) -> web.StreamResponse:
    """The answer to `request`: as much of `content` as it asks for; what is long is sent here."""
    etag = f'"{content.sha256}"'
    headers = {
        "ETag": etag,
        "Cache-Control": content.cache_control,
        "Accept-Ranges": "bytes",
        "Content-Type": content.content_type,
    }
    if _lists(request.headers.get("If-None-Match"), etag):
        return web.Response(status=304, headers=headers)
    wanted = _wanted(request, content.size, etag)
    if isinstance(wanted, Unsatisfiable):
        message = f"the range holds none of {content.size} bytes"
        raise RequestError(416, message, {"Content-Range": f"bytes */{content.size}"})
    status = 200
    if wanted is not None:
        status = 206
        headers["Content-Range"] = f"bytes {wanted.start}-{wanted.stop - 1}/{content.size}"
    chosen = wanted or ByteRange(0, content.size)
    headers["Content-Length"] = str(chosen.stop - chosen.start)
    if request.method == "HEAD":
        return web.Response(status=status, headers=headers)
    body = await content.read(chosen.start, chosen.stop)
    if len(body) <= PIECE_BYTES:
        return web.Response(status=status, headers=headers, body=bytes(body))
    response = web.StreamResponse(status=status, headers=headers)
    connection = Connection(request, request.app[STATE].config.write_timeout_s)
    await connection.prepare(response)
    await connection.send(response, body)
    return response


def _wanted(request: web.Request, size: int, etag: str) -> ByteRange | Unsatisfiable | None:
    """The range to send. One that is bound to another version of the content is ignored."""
    if request.headers.get("If-Range", etag) != etag:
        return None
    return parse_range(request.headers.get("Range"), size)


def _lists(if_none_match: str | None, etag: str) -> bool:
    """Whether the header lists `etag`, compared weakly as RFC 9110 asks here."""
    if if_none_match is None:
        return False
    tags = {tag.strip().removeprefix("W/") for tag in if_none_match.split(",")}
    return etag in tags or "*" in tags
