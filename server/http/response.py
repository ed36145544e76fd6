"""Responses as they go out: values to bytes."""

from __future__ import annotations

import json
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass, field
from email.utils import formatdate
from http import HTTPStatus
from typing import Final

from .bodywriter import BodyWriter

NO_CONTENT: Final = (204, 304)
"""Statuses of responses that never have a body."""

_STATUS_LINES: Final = {
    status.value: f"HTTP/1.1 {status.value} {status.phrase}\r\n".encode() for status in HTTPStatus
}


Facts = Mapping[str, str | int | float | None]
"""What is known of a response, by names of our own."""


@dataclass(slots=True)
class Response:
    """A response that is known whole when it begins."""

    status: int
    fields: Mapping[str, str] = field(default_factory=dict)
    body: bytes | memoryview = b""
    length: int | None = None
    """Content-Length where it is not the length of `body`: the answer to a HEAD."""
    fields_text: bytes = b""
    """All of that as lines of a head, see `whole_fields`, where it was made before."""


@dataclass(slots=True)
class StreamedResponse:
    """A response whose body is made while it is sent."""

    fields: Mapping[str, str]
    produce: Callable[[BodyWriter], Awaitable[None]]
    """Writes the body. The response ends when it returns, and is cut off when it raises."""
    status: int = 200
    facts: Callable[[], Facts] = dict
    """What the log shall say of it when it is over."""


AnyResponse = Response | StreamedResponse


def json_response(
    value: object, status: int = 200, fields: Mapping[str, str] | None = None
) -> Response:
    """`value` as JSON, on one line."""
    body = json.dumps(value).encode()
    return Response(status, {"Content-Type": "application/json", **(fields or {})}, body)


def error_response(status: int, message: str, fields: Mapping[str, str]) -> Response:
    """`message` as the JSON that every error of this server is."""
    return json_response({"error": message}, status, {"Cache-Control": "no-store", **fields})


class HeadWriter:
    """Writes the heads of responses, with what all of them have."""

    def __init__(self, common: Mapping[str, str]) -> None:
        self._common = fields_text(common)
        self._second = -1
        self._begins: dict[int, bytes] = {}  # of this second, by status

    def head(
        self, status: int, fields: bytes, keep_alive: bool, modern: bool, now_s: float
    ) -> bytes:
        """The head of a response. fields: its own ones, see `fields_text`. modern: whether the
        client speaks HTTP/1.1. now_s: since 1970."""
        second = int(now_s)
        if second != self._second:
            self._second, self._begins = second, {}
        begin = self._begins.get(status)
        if begin is None:
            date = f"Date: {formatdate(second, usegmt=True)}\r\n".encode()
            begin = self._begins[status] = b"".join((_STATUS_LINES[status], date, self._common))
        if not keep_alive:
            fields += b"Connection: close\r\n"
        elif not modern:
            fields += b"Connection: keep-alive\r\n"
        return b"".join((begin, fields, b"\r\n"))


def whole_fields(response: Response) -> bytes:
    """The fields of a response as lines of a head, with the length of its body."""
    fields = fields_text(response.fields)
    if response.status in NO_CONTENT:
        return fields
    length = len(response.body) if response.length is None else response.length
    return fields + b"Content-Length: %d\r\n" % length


def fields_text(fields: Mapping[str, str]) -> bytes:
    """Fields as lines of a head. Raises ValueError for a value that would not stay on its line."""
    lines = "".join(f"{name}: {value}\r\n" for name, value in fields.items())
    if lines.count("\n") != len(fields) or lines.count("\r") != len(fields):
        raise ValueError(f"a field of {sorted(fields)} has more than one line")
    return lines.encode("latin-1")
