"""One HTTP/1.1 connection: asyncio's sockets below, h11's grammar above.

Rule: little is read ahead of who reads: what a socket holds, and two of BUFFER_BYTES.
"""

from __future__ import annotations

import asyncio
import os
import re
import socket
import ssl
from base64 import b64encode
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from typing import Any
from urllib.parse import quote, unquote, urlsplit

import h11
from aiohappyeyeballs import AddrInfoType, start_connection

from .handshake import ALERT, handshake_error

BUFFER_BYTES = 64 << 10
"""When twice as much has come that nobody has read, the socket is left alone, bytes."""

STAGGER_S = 0.25
"""Head start that one address of a host has over the next, seconds (RFC 8305)."""

_PRINTABLE = "".join(chr(code) for code in range(0x21, 0x7F))
"""What stays as it is in a path: percent signs, too, which stand before what is quoted already."""


class GrammarError(Exception):
    """What came is not HTTP, or ended before its time."""


class CannotConnectError(Exception):
    """No connection to the host; says why."""

    def __init__(self, error: OSError) -> None:
        if isinstance(error, ssl.SSLError):  # its number is OpenSSL's, not the system's
            super().__init__(f"TLS failed: {error.reason or _one_line(error)}")
            return
        # Of several addresses asyncio gives the errors in one text. The name service's numbers are
        # below 1, and it has words of its own.
        numbers = [error.errno or 0, *map(int, re.findall(r"\[Errno (\d+)\]", str(error)))]
        known = max(numbers)
        super().__init__(os.strerror(known) if known > 0 else _one_line(error))


class Headers(Mapping[str, str]):
    """Fields of an answer by name, in any case; of equal names the first."""

    def __init__(self, pairs: list[tuple[bytes, bytes]]) -> None:
        self._values: dict[str, str] = {}
        for name, value in pairs:
            self._values.setdefault(name.decode("ascii").lower(), value.decode("latin-1"))

    def __getitem__(self, name: str) -> str:
        return self._values[name.lower()]

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)

    def __len__(self) -> int:
        return len(self._values)


@dataclass(frozen=True, slots=True)
class Head:
    """What comes before the body of an answer."""

    status: int
    headers: Headers


@dataclass(frozen=True, slots=True)
class Target:
    """Where a request goes."""

    scheme: str
    host: str
    port: int
    path: bytes
    """With the query; what a URL may not hold is quoted."""
    host_field: str
    authorization: str | None

    @staticmethod
    def of(url: str) -> Target:
        """Raises ValueError for what is not a URL of the web."""
        parts = urlsplit(url)
        if parts.scheme not in ("http", "https") or not parts.hostname:
            raise ValueError(url)
        host = _ascii_host(parts.hostname)
        default = 443 if parts.scheme == "https" else 80
        port = default if parts.port is None else parts.port
        bracketed = f"[{host}]" if ":" in host else host
        path = quote(parts.path or "/", safe=_PRINTABLE)
        if parts.query:
            path += "?" + quote(parts.query, safe=_PRINTABLE)
        authorization = None
        if parts.username is not None:
            user = f"{unquote(parts.username)}:{unquote(parts.password or '')}"
            authorization = f"Basic {b64encode(user.encode()).decode()}"
        field = bracketed if port == default else f"{bracketed}:{port}"
        return Target(parts.scheme, host, port, path.encode("ascii"), field, authorization)

    @property
    def place(self) -> tuple[str, str, int]:
        """What a connection that is kept can be used for again."""
        return self.scheme, self.host, self.port


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split()) or type(error).__name__


def _ascii_host(host: str) -> str:
    """As it is asked for. Raises ValueError for what nobody can be called."""
    if not host.isprintable() or " " in host:
        raise ValueError(host)
    return host.encode("idna").decode("ascii")  # a UnicodeError is a ValueError


async def _addresses(host: str, port: int) -> Sequence[AddrInfoType]:
    """Where a host is. Raises OSError."""
    kind, numeric = socket.SOCK_STREAM, socket.AI_NUMERICHOST
    with suppress(socket.gaierror):  # what is an address need not be looked up, by a thread
        return socket.getaddrinfo(host, port, type=kind, flags=numeric)
    return await asyncio.get_running_loop().getaddrinfo(host, port, type=kind)


@cache
def _tls() -> ssl.SSLContext:
    return ssl.create_default_context()


class HttpConnection:
    """To one host; one request after another."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._reader, self._writer = reader, writer
        is_plain = writer.get_extra_info("ssl_object") is None
        self._other_scheme = "; if it speaks TLS, use https://" if is_plain else ""
        self._http = h11.Connection(h11.CLIENT)
        self._ended = False

    @staticmethod
    async def open(target: Target, timeout_s: float) -> HttpConnection:
        """Raises CannotConnectError, HandshakeError, TimeoutError."""
        context = _tls() if target.scheme == "https" else None
        try:
            async with asyncio.timeout(timeout_s):
                addresses = await _addresses(target.host, target.port)
                # asyncio's own staggered connecting forgets a socket when it is cancelled.
                connected = await start_connection(addresses, happy_eyeballs_delay=STAGGER_S)
                reader, writer = await asyncio.open_connection(
                    limit=BUFFER_BYTES,
                    sock=connected,
                    ssl=context,
                    server_hostname=target.host if context else None,
                )
        except TimeoutError:
            raise
        except ssl.SSLError as error:
            refusal = handshake_error(error, target.host)
            raise refusal or CannotConnectError(error) from error
        except OSError as error:
            raise CannotConnectError(error) from error
        return HttpConnection(reader, writer)

    async def request(
        self, method: str, target: Target, fields: Mapping[str, str], body: bytes | None
    ) -> Head:
        """Sends a request; gives the answer's head. Raises GrammarError, OSError."""
        headers = {"Host": target.host_field, "User-Agent": "swings", "Accept": "*/*"}
        headers["Accept-Encoding"] = "identity"  # objects are compressed already
        if target.authorization is not None:
            headers["Authorization"] = target.authorization
        if body is not None:
            headers["Content-Length"] = str(len(body))
            headers["Content-Type"] = "application/octet-stream"
        headers |= fields
        self._ended = False
        self._send(h11.Request(method=method, target=target.path, headers=list(headers.items())))
        if body:
            self._send(h11.Data(body))
        self._send(h11.EndOfMessage())
        await self._writer.drain()
        while True:
            event = self._http_event()
            if event is h11.NEED_DATA:
                await self._receive()
            elif isinstance(event, h11.Response):
                return Head(event.status_code, Headers(event.headers.raw_items()))

    def _send(self, event: h11.Event) -> None:
        self._writer.write(self._http.send(event) or b"")

    async def piece(self) -> bytes:
        """What has come of the body by now, or comes next; empty at its end. Raises GrammarError,
        OSError."""
        piece = bytearray()
        while not self._ended:
            event = self._http_event()
            if isinstance(event, h11.Data):
                piece += event.data
            elif event is not h11.NEED_DATA:
                self._ended = True
            elif piece:
                break
            else:
                await self._receive()
        return bytes(piece)

    async def _receive(self) -> None:
        data = await self._reader.read(2 * BUFFER_BYTES)
        if self._http.their_state is h11.SEND_RESPONSE and not self._http.trailing_data[0]:
            if data.startswith(ALERT):
                raise GrammarError("the server speaks TLS at this port; try https://")
            if not data:
                raise GrammarError("the server closed it without an answer" + self._other_scheme)
        self._http.receive_data(data)

    def _http_event(self) -> Any:
        try:
            return self._http.next_event()
        except h11.RemoteProtocolError as error:
            raise GrammarError(_one_line(error)) from error

    def is_reusable(self) -> bool:
        """Makes it ready for the next request; False where that needs another connection."""
        if self._http.our_state is not h11.DONE or self._http.their_state is not h11.DONE:
            return False
        self._http.start_next_cycle()
        return self.is_open()

    def is_open(self) -> bool:
        """Whether the host, as far as is known, still listens and has said nothing unasked."""
        return not self._reader.at_eof() and not self._writer.is_closing()

    def close(self) -> None:
        """At once, whatever is under way."""
        self._writer.transport.abort()
