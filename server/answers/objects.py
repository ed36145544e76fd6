"""A stream's files over HTTP, under the same relative paths as on disk."""

from __future__ import annotations

import asyncio
import hashlib
from urllib.parse import parse_qsl

from codec.stream.captions import CAPTIONS_TYPE
from codec.stream.integrity import MAX_INDEX_BYTES
from codec.stream.manifest import Part
from codec.stream.pictures import picture_type
from server.exchange.content import IMMUTABLE, OBJECT_TYPE, REVALIDATE, Content, respond
from server.exchange.errors import RequestError
from server.exchange.response import Response
from server.library import ServedStream

from .call import Answer, Call

MAX_WAIT_S = 30
"""Seconds that a client may wait for an index to grow."""


def manifest(call: Call) -> Response:
    view = call.stream().view
    content = Content(view.manifest_json, view.manifest_sha256, "application/json", REVALIDATE)
    return respond(call.request, content)


def index(call: Call) -> Answer:
    """The index; with ?after=N and &wait=S once it has more than N bytes, or after S seconds."""
    stream = call.stream()
    after_bytes, wait_s = parse_index_query(call.request.query)
    if stream.live and wait_s and len(stream.view.index_data) <= after_bytes:
        return _grown_index(call, stream, wait_s)
    return _index(call, stream)


async def _grown_index(call: Call, stream: ServedStream, wait_s: float) -> Response:
    clock, num_segments = asyncio.get_running_loop().time, stream.view.num_segments
    until_s = clock() + wait_s
    while (
        stream.live
        and not stream.gone
        and not call.state.stopping.is_set()
        and stream.view.num_segments == num_segments
        and clock() < until_s
    ):
        # Not all at once: the server may stop meanwhile.
        await stream.wait_for_growth(num_segments, min(0.5, until_s - clock()))
    return _index(call, call.stream())


def _index(call: Call, stream: ServedStream) -> Response:
    view = stream.view
    content = Content(view.index_data, view.index_sha256, OBJECT_TYPE, REVALIDATE)
    return respond(call.request, content)


def parse_index_query(query: str) -> tuple[int, float]:
    """The bytes of the index that a client has, and the seconds that it waits for more. What is
    asked of other servers for other reasons, such as to get past a cache, is passed over."""
    values = dict(parse_qsl(query, keep_blank_values=True))
    numbers = []
    for key, most in (("after", MAX_INDEX_BYTES), ("wait", MAX_WAIT_S)):
        text = values.get(key, "0")
        if not (text.isascii() and text.isdigit() and len(text) <= 10 and int(text) <= most):
            raise RequestError(400, f"{key}={text[:40]!a} is not a number from 0 to {most}")
        numbers.append(int(text))
    return numbers[0], float(numbers[1])


def segment_object(call: Call) -> Answer:
    stream, segment, name = call.stream(), int(call.names["segment"]), call.names["layer"]
    part: Part = int(name) if name.isdigit() else name
    found = call.state.cache.content(stream, segment, part)
    if found is not None:
        return respond(call.request, found)
    if stream.has_sound(segment, name):
        return _sound(call, stream, segment, name)
    if not stream.has_object(segment, part):
        raise RequestError(404, f"{stream.name} has no segment {segment} layer {name}")
    return _load(call, stream, segment, part)


async def _load(call: Call, stream: ServedStream, segment: int, part: Part) -> Response:
    cache = call.state.cache
    content = await cache.load_content(stream, segment, part)
    cache.make_ready(call.request.path, stream, segment, part)
    return respond(call.request, content)


async def _sound(call: Call, stream: ServedStream, segment: int, name: str) -> Response:
    """An object of sound. Another may take its name, so whoever keeps it asks again."""
    return respond(call.request, await call.state.sounds.content(stream, segment, name))


def web_asset(call: Call) -> Response:
    """A file of the browser player."""
    name = call.name("asset")
    asset = call.state.web_player.assets.get(name)
    if asset is None:
        raise RequestError(404, f"the browser player has no file {name[:80]!a}")
    caching = IMMUTABLE if asset.immutable else REVALIDATE
    content = Content(asset.data, asset.sha256, asset.content_type, caching, asset.coded)
    return respond(call.request, content)


async def picture(call: Call) -> Response:
    """The pictures and captions that the manifest names, and no other file."""
    stream, name = call.stream(), call.name("picture")
    content_type = CAPTIONS_TYPE if name.endswith(".vtt") else picture_type(name)
    data = None
    if content_type is not None:
        read = stream.read_captions if content_type is CAPTIONS_TYPE else stream.read_picture
        data = await asyncio.to_thread(read, name)
    if data is None or content_type is None:
        what = "captions" if content_type is CAPTIONS_TYPE else "picture"
        raise RequestError(404, f"{stream.name} has no {what} {name[:80]!a}")
    sha256 = hashlib.sha256(data).hexdigest()
    return respond(call.request, Content(data, sha256, content_type, REVALIDATE))
