"""The content of a URL, and the part of it that a request asks for (RFC 9110, sections 13 and 14);
and responses whose body is made while it is sent, such as plays.

Rule: a strong tag is a hash of the content, so equal tags mean equal bytes on every server.
"""

from __future__ import annotations

import asyncio
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Final

from aiohttp import HttpVersion11, web

from .connection import UNSEEN_BYTES, connection_of
from .errors import RequestError
from .requestlog import COUNTED_BYTES

MAX_AGE_S = 365 * 24 * 3600

OBJECT_TYPE = "application/octet-stream"
"""Media type of objects and of the index."""

IMMUTABLE = f"public, max-age={MAX_AGE_S}, immutable"
"""For what a URL gives for ever."""

REVALIDATE = "no-cache"
"""For what may change: a cache asks each time and gets a 304."""

NO_STORE = "no-store"
"""For plays and errors: no cache keeps them."""

TURN_BYTES = 1 << 20
"""Bytes of one response that are written before the other connections have their turn."""

MAX_DIGITS = 19
"""Digits read of a position: more than any object has bytes."""

_SINGLE = re.compile(r"bytes=[ \t]*([0-9]*)-([0-9]*)[ \t]*", re.IGNORECASE)


def private_caching(cache_control: str, left_s: int) -> str:
    """`cache_control` of an answer to a signed URL that expires in `left_s` seconds: only the
    client's own cache may keep it, and not for longer."""
    if cache_control == IMMUTABLE:
        return f"private, max-age={max(0, min(left_s, MAX_AGE_S))}, immutable"
    return cache_control if cache_control == NO_STORE else f"private, {REVALIDATE}"


@dataclass(frozen=True, slots=True)
class Content:
    """Bytes with a name of their own."""

    data: bytes
    sha256: str
    content_type: str
    cache_control: str
    coded: Mapping[str, bytes] = field(default_factory=dict)
    """The bytes under each Content-Encoding in which they can be had whole; a client gets the first
    that it takes."""
    count: Callable[[int], None] = lambda num_bytes: None
    """Called with the number of bytes of it that are sent."""


@dataclass(frozen=True, slots=True)
class Part:
    """What a request gets of a content."""

    status: int
    headers: Mapping[str, str]
    body: bytes | memoryview = b""


def part_of(content: Content, request: web.BaseRequest) -> Part:
    """The answer to a GET or HEAD. Raises RequestError 412 or 416."""
    asked, data, tag, coding = request.headers, content.data, content.sha256, ""
    if content.coded and "Range" not in asked:
        takes = accepted_codings(joined(request, "Accept-Encoding"))
        coding = next((name for name in content.coded if name in takes), "")
    if coding:
        data, tag = content.coded[coding], f"{tag}-{coding}"
    etag = f'"{tag}"'
    headers = {
        "Content-Type": content.content_type,
        "ETag": etag,
        "Cache-Control": content.cache_control,
        "Accept-Ranges": "bytes",
    }
    if content.coded:
        headers["Vary"] = "Accept-Encoding"
    if coding:
        headers["Content-Encoding"] = coding
    if "If-Match" in asked and not _lists(joined(request, "If-Match"), etag, weakly=False):
        raise RequestError(412, "If-Match does not match the content", {"ETag": etag})
    if "If-None-Match" in asked and _lists(joined(request, "If-None-Match"), etag, weakly=True):
        return Part(304, headers)
    # A range that is bound to another version of the content is ignored.
    if "Range" not in asked or asked.get("If-Range", etag) != etag:
        return Part(200, headers, data)
    wanted = parse_range(joined(request, "Range"), len(data))
    if wanted is None:
        return Part(200, headers, data)
    if not wanted:
        message = f"the range is outside the {len(data)} bytes of the content"
        raise RequestError(416, message, {"Content-Range": f"bytes */{len(data)}"})
    headers["Content-Range"] = f"bytes {wanted.start}-{wanted.stop - 1}/{len(data)}"
    return Part(206, headers, memoryview(data)[wanted.start : wanted.stop])


async def serve(request: web.Request, content: Content) -> web.StreamResponse:
    """Answers a GET or HEAD with as much of `content` as it asks for. Raises RequestError."""
    part = part_of(content, request)
    body = part.body
    if request.method == "GET" and part.status != 304:
        content.count(len(body))
    if request.method == "HEAD" or len(body) <= UNSEEN_BYTES:
        return web.Response(status=part.status, headers=part.headers, body=bytes(body))
    headers = {**part.headers, "Content-Length": str(len(body))}
    response = web.Response(status=part.status, headers=headers)
    await response.prepare(request)
    # Piece by piece, as the client takes it: the transport keeps what the kernel does not take.
    connection, view = connection_of(request), memoryview(body)
    start = turn_bytes = 0
    while start < len(view):
        if turn_bytes >= TURN_BYTES:
            turn_bytes = 0
            await asyncio.sleep(0)
        piece = view[start : start + connection.piece_bytes]
        await response.write(piece)
        start, turn_bytes = start + len(piece), turn_bytes + len(piece)
    await connection.deliver(closing=not request.keep_alive)
    return response


def parse_range(header: str, size: int) -> range | None:
    """The range that `header` asks of `size` bytes, empty where it holds none of them: 416. None
    where all bytes are to be sent.

    A header that is malformed, of another unit or of several ranges counts as absent, as the RFC
    allows.
    """
    match = _SINGLE.fullmatch(header)
    if match is None:
        return None
    first, last = match.groups()
    if max(len(first), len(last)) > MAX_DIGITS or not (first or last):
        return None
    if not first:
        return range(max(0, size - int(last)), size)
    if last and int(last) < int(first):
        return None
    return range(int(first), min(int(last) + 1, size) if last else size)


def joined(request: web.BaseRequest, name: str) -> str:
    """All values of a header that may stand in several lines; empty where there is none."""
    return ", ".join(request.headers.getall(name, ()))


def _lists(listed: str, etag: str, weakly: bool) -> bool:
    """Whether a list of tags has `etag`; weakly: also as a weak one."""
    tags = {tag.strip() for tag in listed.split(",")}
    return etag in tags or "*" in tags or (weakly and f"W/{etag}" in tags)


def accepted_codings(accepted: str) -> frozenset[str]:
    """The codings that an Accept-Encoding names and allows (RFC 9110, section 12.5.3)."""
    weights = {}
    for entry in accepted.split(","):
        name, _, weight = (part.strip().lower() for part in entry.partition(";"))
        weights[name] = weight
    return frozenset(
        name for name, weight in weights.items() if not re.fullmatch(r"q\s*=\s*0(\.0*)?", weight)
    )


STREAM_TURN_BYTES: Final = 64 * 1024
"""As TURN_BYTES, for a body that is made while it is sent, whose bytes cost work."""


class StreamedResponse:
    """Sends a body to one client, and knows the client's progress. All of it raises a
    ConnectionError when the client has gone."""

    def __init__(
        self, request: web.Request, headers: Mapping[str, str], count: Callable[[int], None]
    ) -> None:
        """count: called with the number of bytes sent, while they are sent: a play of an hour is
        load for the whole hour."""
        self._request = request
        self._response = web.StreamResponse(headers=headers)
        if request.version < HttpVersion11:
            self._response.force_close()  # only the end of the connection ends it
        self._count = count
        self._counted_bytes = 0
        self._turn_bytes = 0  # written since the other connections had their turn
        self.connection = connection_of(request)

    async def write(self, data: bytes) -> None:
        """Writes `data`, and waits until there is room for more."""
        writer = self._request.writer
        try:
            await self._response.prepare(self._request)
            await self._response.write(data)
            await writer.drain()
        except ConnectionError:
            await asyncio.sleep(0)  # for the connection, which is told why it is lost
            raise
        self._count(writer.output_size - self._counted_bytes)
        self._request[COUNTED_BYTES] = self._counted_bytes = writer.output_size
        self._turn_bytes += len(data)
        if self._turn_bytes >= STREAM_TURN_BYTES:
            self._turn_bytes = 0
            await asyncio.sleep(0)

    async def end(self) -> web.StreamResponse:
        """Ends the body, and waits until it has arrived; gives what the handler returns."""
        await self._response.prepare(self._request)
        await self._response.write_eof()
        await self.connection.deliver(closing=not self._response.keep_alive)
        return self._response
