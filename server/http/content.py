"""What a URL stands for, and how much of it a request asks for (RFC 9110, sections 13 and 14).

Rule: a strong tag is a hash of the content, so equal tags mean equal bytes on every server.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass

from .byterange import ByteRange, Unsatisfiable, parse_range
from .errors import RequestError
from .request import Request
from .response import Response

IMMUTABLE = "public, max-age=31536000, immutable"
"""For what a URL gives for ever."""

REVALIDATE = "no-cache"
"""For what may change: a cache asks each time and gets a 304."""


@dataclass(frozen=True, slots=True)
class Content:
    """Bytes with a name of their own."""

    data: bytes
    size: int
    sha256: str
    content_type: str
    cache_control: str
    coding: str = ""
    """A Content-Encoding under which these very bytes can be had, whole, besides as they are."""
    count: Callable[[int], None] | None = None
    """Is told how many bytes of it are on their way."""


def respond(request: Request, content: Content) -> Response:
    """The answer to a GET or HEAD: as much of `content` as is asked for.

    Raises RequestError 412 or 416.
    """
    asked = request.fields
    coding = content.coding if "range" not in asked and _takes(asked, content.coding) else ""
    etag = f'"{content.sha256}-{coding}"' if coding else f'"{content.sha256}"'
    fields = {
        "Content-Type": content.content_type,
        "ETag": etag,
        "Cache-Control": content.cache_control,
        "Accept-Ranges": "bytes",
    }
    if content.coding:
        fields["Vary"] = "Accept-Encoding"
    if coding:
        fields["Content-Encoding"] = coding
    start, stop, status = 0, content.size, 200
    if "if-match" in asked and not _lists(asked["if-match"], etag, weakly=False):
        raise RequestError(412, "If-Match does not match the content", {"ETag": etag})
    if "if-none-match" in asked and _lists(asked["if-none-match"], etag, weakly=True):
        return Response(304, fields)
    wanted = _wanted(request, content.size, etag)
    if isinstance(wanted, Unsatisfiable):
        message = f"the range is outside the {content.size} bytes of the content"
        raise RequestError(416, message, {"Content-Range": f"bytes */{content.size}"})
    if wanted is not None:
        start, stop, status = wanted.start, wanted.stop, 206
        fields["Content-Range"] = f"bytes {start}-{stop - 1}/{content.size}"
    if request.method == "HEAD":
        return Response(status, fields, length=stop - start)
    if content.count is not None:
        content.count(stop - start)
    return Response(status, fields, memoryview(content.data)[start:stop])


def _wanted(request: Request, size: int, etag: str) -> ByteRange | Unsatisfiable | None:
    """The range to send. One that is bound to another version of the content is ignored."""
    if request.fields.get("if-range", etag) != etag:
        return None
    return parse_range(request.fields.get("range"), size)


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


def _takes(fields: dict[str, str], coding: str) -> bool:
    return bool(coding) and coding in accepted_codings(fields.get("accept-encoding", ""))
