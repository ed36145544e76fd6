"""Responses as values, before anything is sent."""

from __future__ import annotations

import json
import re
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass, field
from email.utils import formatdate
from http import HTTPStatus
from typing import Final, Protocol

from .tcpinfo import TcpInfo

NO_CONTENT: Final = (204, 304)
"""Statuses of responses that never have a body."""

_ON_ONE_LINE = re.compile(r"[^\x00-\x08\x0a-\x1f\x7f]*")

Facts = Mapping[str, str | int | float | None]
"""Facts about a response for the log, by field name."""


class BodyWriter(Protocol):
    """Sends a body to one client, and reports the client's progress.

    When the client goes away, the task that writes is cancelled.
    """

    @property
    def cut(self) -> str:
        """Why the connection is over: "gone", "stalled" or "stopped"; empty while it is not."""

    def hold_at_most(self, queue_bytes: int) -> None:
        """Lets about `queue_bytes` wait unsent in the process, and as many in the kernel."""

    def queued_bytes(self) -> int:
        """Bytes written but not yet acknowledged by the client's side, as far as one can see."""

    def tcp_info(self) -> TcpInfo | None:
        """The kernel's figures of the connection; None if it reports none."""

    async def write(self, data: bytes) -> None:
        """Writes `data`, and waits until there is room for more."""


@dataclass(slots=True)
class Response:
    """A response that is known whole when it begins."""

    status: int
    fields: Mapping[str, str] = field(default_factory=dict)
    body: bytes | memoryview = b""
    length: int | None = None
    """Content-Length where it is not the length of `body`: the answer to a HEAD."""
    prepared: bytes = b""
    """All fields as lines of a head, see `fields_text`, where they were made before."""

    def head_fields(self) -> bytes:
        """The fields as lines of a head, with the length of the body."""
        if self.prepared or self.status in NO_CONTENT:
            return self.prepared or fields_text(self.fields)
        length = len(self.body) if self.length is None else self.length
        return fields_text(self.fields) + b"Content-Length: %d\r\n" % length


@dataclass(slots=True)
class StreamedResponse:
    """A response whose body is made while it is sent."""

    fields: Mapping[str, str]
    produce: Callable[[BodyWriter], Awaitable[None]]
    """Writes the body. The response ends when it returns, and is cut off when it raises."""
    facts: Callable[[], Facts] = dict
    """Facts to log when the response is over."""


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


def fields_text(fields: Mapping[str, str]) -> bytes:
    """Fields as lines of a head. Raises ValueError for one that would not stay on its line."""
    lines = []
    for name, value in fields.items():
        if not _ON_ONE_LINE.fullmatch(name + value):
            raise ValueError(f"the field {name!a} has more than one line, or control characters")
        lines.append(f"{name}: {value}\r\n")
    return "".join(lines).encode("latin-1")


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
            line = f"HTTP/1.1 {status} {HTTPStatus(status).phrase}\r\n"
            date = f"Date: {formatdate(second, usegmt=True)}\r\n"
            begin = self._begins[status] = f"{line}{date}".encode() + self._common
        connection = b"" if keep_alive else b"Connection: close\r\n"
        if keep_alive and not modern:
            connection = b"Connection: keep-alive\r\n"
        return b"".join((begin, fields, connection, b"\r\n"))
