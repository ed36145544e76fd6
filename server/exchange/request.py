"""A request as values, with a single interpretation where aiohttp's parser leaves several.

Rule: what two servers could understand in two ways is refused: two hosts, a host that is not one, a
target that is not a path, a body in chunks.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Final

from multidict import CIMultiDict, CIMultiDictProxy

from .errors import RequestError

_TARGET = re.compile(
    r"(?:(?i:https?)://(?P<authority>[^/?# ]*))?"
    r"(?P<path>/[^?# \x00-\x20\x7f-\U0010ffff]*|\*)"
    r"(?:\?(?P<query>[^# \x00-\x20\x7f-\U0010ffff]*))?"
)
_HOST = re.compile(r"(?:[A-Za-z0-9._-]{1,255}|\[[0-9A-Fa-f:.]{2,64}\])(?::(?P<port>[0-9]{1,5}))?")

_CHOOSING: Final = ("Range", "If-Range", "If-Match", "If-None-Match")
"""Fields by which a client may ask for less than all."""

Fields = CIMultiDictProxy[str] | CIMultiDict[str]
"""The fields of a head; their names in any case."""


@dataclass(slots=True)
class Request:
    """A request, with its body where it has one."""

    method: str
    path: str
    """As it was sent, so still with its %XX; begins with a slash."""
    query: str
    """The part behind the question mark, as it was sent."""
    host: str
    """HOST or HOST:PORT, as the client calls the server; empty in HTTP/1.0 that names none."""
    fields: Fields
    body: bytes = b""

    @property
    def is_plain(self) -> bool:
        """Whether it is a GET of all that the path names, whatever the client has, uncoded."""
        fields = self.fields
        return (
            self.method == "GET"
            and not self.query
            and not any(name in fields for name in _CHOOSING)
            and "zstd" not in fields.get("Accept-Encoding", "")
        )

    def joined(self, name: str) -> str:
        """All values of a field that may stand in several lines; empty where there is none."""
        return ", ".join(self.fields.getall(name, ()))


def read_request(method: str, target: str, fields: Fields) -> Request:
    """The request with this target. Raises RequestError 400 or 411 for what is not one; the
    connection cannot be used after that."""
    match = _TARGET.fullmatch(target)
    if match is None or (match["path"] == "*" and method != "OPTIONS"):
        raise RequestError(400, "the target is not a path, such as /v1/streams")
    if "Transfer-Encoding" in fields:
        raise RequestError(411, "send a Content-Length, not a Transfer-Encoding")
    host = fields.get("Host")
    if host is not None:
        host = _checked_host(host)
    if match["authority"] is not None:
        host = _checked_host(match["authority"])
    return Request(method, match["path"], match["query"] or "", host or "", fields)


def body_bytes(request: Request, max_bytes: int) -> int:
    """Length of the body. Raises RequestError 413, and 417 where its client expects the unknown."""
    if request.fields.get("Expect", "100-continue").lower() != "100-continue":
        raise RequestError(417, "100-continue is the only supported expectation")
    length = int(request.fields.get("Content-Length", "0"))  # checked by the parser
    if length > max_bytes:
        raise RequestError(413, f"the body may have at most {max_bytes} bytes here")
    return length


def _checked_host(text: str) -> str:
    match = _HOST.fullmatch(text)
    if match is None or int(match["port"] or 0) > 65535:
        raise RequestError(400, f"Host {text[:80]!a} is not HOST or HOST:PORT")
    return text
