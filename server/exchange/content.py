"""The content of a URL, and the part of it that a request asks for (RFC 9110, sections 13 and 14).

Rule: a strong tag is a hash of the content, so equal tags mean equal bytes on every server.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from .byterange import parse_range
from .errors import RequestError
from .request import Request
from .response import Response

MAX_AGE_S = 365 * 24 * 3600

OBJECT_TYPE = "application/octet-stream"
"""Media type of objects and of the index."""

IMMUTABLE = f"public, max-age={MAX_AGE_S}, immutable"
"""For what a URL gives for ever."""

REVALIDATE = "no-cache"
"""For what may change: a cache asks each time and gets a 304."""

NO_STORE = "no-store"
"""For plays and errors: no cache keeps them."""


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
    count: Callable[[int], None] | None = None
    """Called with the number of bytes of it that are sent."""


def respond(request: Request, content: Content) -> Response:
    """The answer to a GET or HEAD: as much of `content` as is asked for.

    Raises RequestError 412 or 416.
    """
    asked, data, tag, coding = request.fields, content.data, content.sha256, ""
    if content.coded and "Range" not in asked:
        takes = accepted_codings(request.joined("Accept-Encoding"))
        coding = next((name for name in content.coded if name in takes), "")
    if coding:
        data, tag = content.coded[coding], f"{tag}-{coding}"
    etag = f'"{tag}"'
    fields = {
        "Content-Type": content.content_type,
        "ETag": etag,
        "Cache-Control": content.cache_control,
        "Accept-Ranges": "bytes",
    }
    if content.coded:
        fields["Vary"] = "Accept-Encoding"
    if coding:
        fields["Content-Encoding"] = coding
    start, stop, status = 0, len(data), 200
    if "If-Match" in asked and not _lists(request.joined("If-Match"), etag, weakly=False):
        raise RequestError(412, "If-Match does not match the content", {"ETag": etag})
    if "If-None-Match" in asked and _lists(request.joined("If-None-Match"), etag, weakly=True):
        return Response(304, fields)
    # A range that is bound to another version of the content is ignored.
    bound_to = asked.get("If-Range", etag)
    wanted = parse_range(request.joined("Range"), len(data)) if bound_to == etag else None
    if wanted is not None and not wanted:
        message = f"the range is outside the {len(data)} bytes of the content"
        raise RequestError(416, message, {"Content-Range": f"bytes */{len(data)}"})
    if wanted is not None:
        start, stop, status = wanted.start, wanted.stop, 206
        fields["Content-Range"] = f"bytes {start}-{stop - 1}/{len(data)}"
    if request.method == "HEAD":
        return Response(status, fields, length=stop - start)
    if content.count is not None:
        content.count(stop - start)
    return Response(status, fields, memoryview(data)[start:stop])


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
