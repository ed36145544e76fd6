"""One client's connection: aiohttp speaks HTTP on it; here is what the kernel knows of it, why it
ended, and how much of a response has arrived."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

from aiohttp import web
from aiohttp.http import HttpProcessingError
from aiohttp.http_exceptions import LineTooLong

from server.operate.admission import Admission
from server.operate.prometheus import Metrics

from .errors import RequestError
from .requestlog import NOTE
from .tcpinfo import TcpInfo, read_tcp_info, unacked_bytes

MAX_TARGET_BYTES: Final = 8 * 1024
MAX_FIELD_BYTES: Final = MAX_TARGET_BYTES - 1
"""Of a name and its value. One less, because aiohttp's error tells the two apart by their limit
alone."""
MAX_FIELDS: Final = 100

QUEUE_BYTES: Final = 8 * 1024
"""Bytes that may wait in the process before no more are written."""

PIECES_BYTES: Final = 16 * 1024 * 1024
"""Bytes of bodies that may wait in the process, about, shared by all connections."""

MIN_PIECE_BYTES: Final = 16 * 1024
MAX_PIECE_BYTES: Final = 512 * 1024

UNSEEN_BYTES: Final = 64 * 1024
"""Unacknowledged bytes with which a response counts as delivered: about what the client's kernel
may hold of it unseen, too."""

FIRST_LOOK_S: Final = 0.005
MAX_LOOK_S: Final = 0.5
"""Seconds until a connection first asks the kernel what was acknowledged, and most between two."""


def refusal(status: int, phrase: str, *fields: str) -> bytes:
    """A response without a body, after which the connection ends."""
    lines = (f"HTTP/1.1 {status} {phrase}", *fields, "Content-Length: 0", "Connection: close")
    return "".join(f"{line}\r\n" for line in (*lines, "")).encode()


TOO_MANY: Final = refusal(429, "Too Many Requests", "Retry-After: 5")


@dataclass(frozen=True, slots=True)
class Clients:
    """What all connections share."""

    admission: Admission
    """Counts them."""
    metrics: Metrics
    headers: Mapping[str, str]
    """Those of every response."""


class Connection(web.RequestHandler):
    """aiohttp's protocol of a connection, within the limits of connections."""

    def __init__(self, clients: Clients, server: web.Server, options: Mapping[str, Any]) -> None:
        """options: of web.RequestHandler."""
        loop = asyncio.get_running_loop()
        super().__init__(server, loop=loop, **options)
        self._clients = clients
        self._event_loop = loop
        self._address: str | None = None  # where it is counted
        self.cut = ""
        """Why it is over: "gone" or "stalled"; empty while it is not."""
        self.was_asked = False
        """Whether a request has come."""
        self._arrival: asyncio.Future[None] | None = None  # while a response is delivered

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        address = str(transport.get_extra_info("peername")[0])
        refused = self._clients.admission.admit(address)
        if refused is not None:
            self._clients.metrics.refused.add(1, f"connection_{refused}")
            transport.write(TOO_MANY)
            transport.close()
            return
        self._address = address
        self._socket: Any = transport.get_extra_info("socket")
        # A piece that the kernel does not take is enough to wait for.
        transport.set_write_buffer_limits(high=QUEUE_BYTES)
        super().connection_made(transport)

    def data_received(self, data: bytes) -> None:
        if self._arrival is not None:
            self._wake()
        super().data_received(data)

    def connection_lost(self, exc: BaseException | None) -> None:
        if self._address is None:
            return
        self._clients.admission.release(self._address)
        self.cut = "gone"
        if isinstance(exc, TimeoutError):  # the kernel's, see `bound_connections`
            self._clients.metrics.timeouts.add(1, "write")
            self.cut = "stalled"
        super().connection_lost(exc)
        self._wake()

    def handle_error(
        self,
        request: web.BaseRequest,
        status: int = 500,
        exc: BaseException | None = None,
        message: str | None = None,
    ) -> web.StreamResponse:
        """Answers what is not HTTP as all other errors are answered, and with one line of log."""
        if not isinstance(exc, HttpProcessingError) or request.writer.output_size:
            return super().handle_error(request, status, exc, message)
        status, request[NOTE] = _reason_of(exc)
        error = RequestError(status, request[NOTE], self._clients.headers)
        error.force_close()
        raise error

    # What a response asks.

    @property
    def piece_bytes(self) -> int:
        """How much of a body is written in one go: the transport keeps what the kernel does not
        take."""
        share_bytes = PIECES_BYTES // max(1, self._clients.admission.num_held)
        return max(MIN_PIECE_BYTES, min(MAX_PIECE_BYTES, share_bytes))

    def hold_at_most(self, queue_bytes: int) -> None:
        """Lets about `queue_bytes` wait unsent in the process, and as many in the kernel."""
        self._there.set_write_buffer_limits(high=queue_bytes, low=queue_bytes // 4)
        if hasattr(socket, "TCP_NOTSENT_LOWAT"):
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NOTSENT_LOWAT, queue_bytes)

    def queued_bytes(self) -> int:
        """Bytes written but not yet acknowledged by the client's side, as far as one can see.
        Raises ConnectionResetError if the client has gone."""
        return self._there.get_write_buffer_size() + unacked_bytes(self._socket)

    def tcp_info(self) -> TcpInfo | None:
        """The kernel's figures of the connection; None if it reports none, or none any more."""
        return read_tcp_info(self._socket)

    async def deliver(self, closing: bool) -> None:
        """Waits until the client has nearly all that was written, or sends more. Raises
        ConnectionResetError if the client has gone. closing: whether it is the last response."""
        look_s = FIRST_LOOK_S
        while self.queued_bytes() > UNSEEN_BYTES:
            if closing and self._there.can_write_eof():
                self._there.write_eof()  # the client need not wait for the looks
            self._arrival = self._event_loop.create_future()
            timer = self._event_loop.call_later(look_s, self._wake)
            try:
                await self._arrival
            finally:
                timer.cancel()
                self._arrival = None
            look_s = min(2 * look_s, MAX_LOOK_S)

    @property
    def _there(self) -> asyncio.Transport:
        if self.transport is None:
            raise ConnectionResetError("the client has gone")
        return self.transport

    def _wake(self) -> None:
        if self._arrival is not None and not self._arrival.done():
            self._arrival.set_result(None)


def _reason_of(error: HttpProcessingError) -> tuple[int, str]:
    """Status and reason of the answer to what aiohttp could not read."""
    if isinstance(error, LineTooLong):
        if error.args[1] == MAX_TARGET_BYTES:
            return 414, f"the target of the request has more than {MAX_TARGET_BYTES} bytes"
        return 431, f"a field of the head has more than {MAX_FIELD_BYTES} bytes"
    if "Too many headers" in error.message:
        return 431, f"the head has more than {MAX_FIELDS} fields"
    return 400, "the request is not HTTP"


def connection_of(request: web.BaseRequest) -> Connection:
    """The connection on which a request came."""
    connection = request.protocol
    assert isinstance(connection, Connection)
    return connection
