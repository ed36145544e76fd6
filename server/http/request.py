"""Requests as they come in: bytes to values, or one error (RFC 9112).

Rule: no sockets and no clock, and one reading only. What two servers could understand in two ways
is refused: bare line ends, folded lines, a space before a colon, two lengths, two hosts.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Final

from .errors import RequestError

MAX_LINE_BYTES: Final = 8 * 1024
MAX_HEAD_BYTES: Final = 16 * 1024
"""Longest head, with the empty line that ends it."""
MAX_FIELDS: Final = 100

HEAD_END: Final = b"\r\n\r\n"

_LINE = re.compile(
    r"(?P<method>[!#$%&'*+.^_`|~0-9A-Za-z-]{1,32})"
    r" (?:(?i:https?)://(?P<authority>[^/?# ]*))?"
    r"(?P<path>/[^?# \x00-\x20\x7f-\xff]*|(?<=OPTIONS )\*)"
    r"(?:\?(?P<query>[^# \x00-\x20\x7f-\xff]*))? HTTP/1\.(?P<minor>[0-9])"
)
_ANY_LINE = re.compile(r"[\x21-\x7e]+ [\x21-\x7e]+ HTTP/(?P<major>[0-9])(?:\.[0-9])?")
_FIELD = re.compile(
    rb"([!#$%&'*+.^_`|~0-9A-Za-z-]+):[ \t]*((?:[\x21-\x7e\x80-\xff](?:[ \t\x21-\x7e\x80-\xff]*"
    rb"[\x21-\x7e\x80-\xff])?)?)[ \t]*"
)
_HOST = re.compile(r"(?:[A-Za-z0-9._-]{1,255}|\[[0-9A-Fa-f:.]{2,64}\])(?::(?P<port>[0-9]{1,5}))?")
_LENGTH = re.compile(r"[0-9]{1,15}")

_CHOOSING: Final = {
    "range",
    "if-range",
    "if-match",
    "if-none-match",
}
"""Fields by which a client may ask for less than all."""

Fields = dict[str, str]
"""The values of a head by their names in small letters; several of one name joined by ", "."""


@dataclass(slots=True)
class Request:
    """A request, with its body where it has one."""

    method: str
    path: str
    """As it was sent, so still with its %XX; begins with a slash."""
    query: str
    """What stands behind the question mark, as it was sent."""
    host: str
    """HOST or HOST:PORT, as the client calls the server; empty in HTTP/1.0 that names none."""
    fields: Fields
    keep_alive: bool
    """Whether the client takes another response on the same connection."""
    chunks: bool
    """Whether it takes a body in chunks: not before HTTP/1.1."""
    is_plain: bool
    """Whether it is a GET of all that the path names, whatever the client has, uncoded."""
    body_bytes: int = 0
    """Length that the head gives of the body."""
    body: bytes = b""

    @property
    def forwarded(self) -> str:
        """The addresses that proxies say the request comes from; empty where there are none."""
        return self.fields.get("x-forwarded-for", "")

    @property
    def waits_to_send(self) -> bool:
        """Whether the client holds its body back until it is told to go on. In HTTP/1.0 nobody
        does, whatever it says (RFC 9110, section 10.1.1)."""
        expects = self.fields.get("expect", "").lower() == "100-continue"
        return expects and self.chunks and self.body_bytes > 0


class HeadParser:
    """Reads the heads of one connection. Raises RequestError for what is not one; the connection
    cannot be used after that."""

    def __init__(self, max_body_bytes: int) -> None:
        self._max_body_bytes = max_body_bytes
        # A client sends the same fields again and again.
        self._block = b""
        self._fields: Fields = {}
        self._host = ""
        self._length = 0
        self._closes = False
        self._stays = False
        self._plain = False

    def parse(self, head: bytes) -> Request:
        """The request whose head is `head`, without the empty line at its end."""
        line, _, block = head.partition(b"\r\n")
        match = _LINE.fullmatch(line.decode("latin-1"))
        if match is None:
            raise _wrong_line(line)
        if len(line) > MAX_LINE_BYTES:
            raise RequestError(414, f"the request line has more than {MAX_LINE_BYTES} bytes")
        if block != self._block or not block:
            self._read_fields(block)
        method, authority, path, query, minor = match.groups()
        modern = minor != "0"
        if modern and not self._host:
            raise RequestError(400, "HTTP/1.1 requires the field Host")
        return Request(
            method,
            path,
            query or "",
            self._host if authority is None else _checked_host(authority),
            self._fields,
            not self._closes if modern else self._stays,
            modern,
            self._plain and method == "GET" and query is None,
            self._length,
        )

    def _read_fields(self, block: bytes) -> None:
        fields: Fields = {}
        lines = block.split(b"\r\n") if block else []
        if len(lines) > MAX_FIELDS:
            raise RequestError(431, f"the head has more than {MAX_FIELDS} fields")
        for line in lines:
            match = _FIELD.fullmatch(line)
            if match is None:
                raise RequestError(400, "a line of the head is not NAME: VALUE")
            name, value = match[1].decode("ascii").lower(), match[2].decode("latin-1")
            if name not in fields:
                fields[name] = value
            elif name in ("host", "content-length", "transfer-encoding"):
                raise RequestError(400, f"the head has the field {name} twice")
            else:
                fields[name] += ", " + value
        self._length = self._body_length(fields)
        self._host = _checked_host(fields["host"]) if "host" in fields else ""
        self._plain = not _CHOOSING & fields.keys() and "zstd" not in fields.get(
            "accept-encoding", ""
        )
        tokens = {token.strip().lower() for token in fields.get("connection", "").split(",")}
        self._closes, self._stays = "close" in tokens, "keep-alive" in tokens
        self._fields, self._block = fields, block

    def _body_length(self, fields: Fields) -> int:
        if "transfer-encoding" in fields:
            if "content-length" in fields:
                raise RequestError(400, "the head has both a length and a transfer coding")
            raise RequestError(411, "send a Content-Length, not a Transfer-Encoding")
        if fields.get("expect", "100-continue").lower() != "100-continue":
            raise RequestError(417, "100-continue is the only supported expectation")
        text = fields.get("content-length", "0")
        if not _LENGTH.fullmatch(text):
            raise RequestError(400, "Content-Length is not a number")
        if int(text) > self._max_body_bytes:
            raise RequestError(413, f"the body may have at most {self._max_body_bytes} bytes here")
        return int(text)


def _wrong_line(line: bytes) -> RequestError:
    match = _ANY_LINE.fullmatch(line.decode("latin-1"))
    if match is None:
        return RequestError(400, "the request line is not METHOD TARGET HTTP/1.1")
    if match["major"] != "1":
        return RequestError(505, "this server supports only HTTP/1.1 and HTTP/1.0")
    return RequestError(400, "the target is not a path, such as /v1/streams")


def _checked_host(text: str) -> str:
    match = _HOST.fullmatch(text)
    if match is None or int(match["port"] or 0) > 65535:
        raise RequestError(400, f"Host {text[:80]!a} is not HOST or HOST:PORT")
    return text
