"""One client's connection: aiohttp speaks HTTP on it, within bounds of time and of bytes.

Rule: whatever a client sends or does not send, it costs a bounded amount of memory for a bounded
time, and never more than its own connection.
"""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Final

from aiohttp import web
from aiohttp.abc import AbstractStreamWriter

from server.exchange.tcpinfo import TcpInfo, read_tcp_info, unacked_bytes
from server.operate.prometheus import Metrics

from .timeouts import TimeoutConfig

READ_BYTES: Final = 16 * 1024
"""Bytes that are read in one go."""

MAX_AHEAD_BYTES: Final = 64 * 1024
"""Bytes of a head, or of what comes behind a request that is being answered."""

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

LINGER_S: Final = 2.0
"""Seconds for the end of a connection after its last response."""

LAST_CALL_S: Final = 0.5
"""Seconds for the first request of a client that was accepted just before the server stopped."""

HALF_CLOSED_S: Final = 0.05
"""Seconds for the next request of a client that has closed its side, if it sent more than one."""

_INCOMING: Final = memoryview(bytearray(READ_BYTES))
"""Buffer that all connections read into in turn: each copies its bytes before the next reads."""


Refused = Callable[[str, int, str], None]
"""Called for each request that was refused before it was read: address, status, and why."""


def refusal(status: int, phrase: str, *fields: str) -> bytes:
    """A response without a body, after which the connection ends."""
    lines = (f"HTTP/1.1 {status} {phrase}", *fields, "Content-Length: 0", "Connection: close")
    return "".join(f"{line}\r\n" for line in (*lines, "")).encode()


@dataclass(frozen=True, slots=True)
class Clients:
    """The shared state of all connections of a worker."""

    make_http: Callable[[], asyncio.Protocol]
    """Makes aiohttp's protocol of a connection."""
    refused: Refused
    timeouts: TimeoutConfig
    metrics: Metrics
    connections: set[ClientConnection] = field(default_factory=set)
    """The open connections."""


class ClientConnection(asyncio.BufferedProtocol):
    """Passes on to aiohttp what comes in, and ends the connection of a client that takes too long,
    or sends too much."""

    transport: asyncio.Transport

    def __init__(
        self, clients: Clients, address: str, closed: Callable[[ClientConnection], None]
    ) -> None:
        """address: of the client. closed: called once at the end of a connection that `began`."""
        self._clients = clients
        self._http = clients.make_http()
        self.address = address
        self._closed = closed
        self.began = False
        """Whether there was a connection, after any handshake; if so, it reports its end itself."""
        self.cut = ""
        """Why it is over: "gone", "stalled", "flood" or "stopped"; empty while it is not."""
        self.needs_client = False
        """Whether the request has no answer once its client has closed its side."""
        self.is_answering = False
        """Whether a request has begun whose response is not on its way yet."""
        self._writer: AbstractStreamWriter | None = None  # of the newest response, if any
        self._begun = False  # whether a part of a request has come since the last
        self._stopping = False
        self._ending = False  # whether the last response has been sent
        self.is_half_closed = False
        """Whether the client sends no more."""
        self._ahead_bytes = 0
        self._before_bytes = 0  # written in the responses before the newest
        self._taken_bytes = 0  # of all that was written
        self._look: asyncio.Future[None] | None = None  # while the last response is delivered

    # What asyncio calls.

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self.began = True
        self.transport = transport
        self._socket: Any = transport.get_extra_info("socket")
        self._loop = asyncio.get_running_loop()
        self._deadline_s = self._request_deadline_s()
        # A piece that the kernel does not take is enough to wait for.
        transport.set_write_buffer_limits(high=QUEUE_BYTES)
        self._http.connection_made(transport)

    def get_buffer(self, sizehint: int) -> memoryview:
        return _INCOMING

    def buffer_updated(self, nbytes: int) -> None:
        if not (self.is_answering or self._begun or self._ending):
            # From the first byte on, whatever trickles in later.
            self._begun = True
            self._deadline_s = self._request_deadline_s()
        self._ahead_bytes += nbytes
        self._wake()
        if self._ahead_bytes > MAX_AHEAD_BYTES and not self._ending:
            if not self.is_answering:
                self._refuse(431, "Request Header Fields Too Large", "the head is too long")
            self._clients.metrics.timeouts.add(1, "flood")
            self.abort("flood")
        else:
            self._http.data_received(bytes(_INCOMING[:nbytes]))

    def eof_received(self) -> bool:
        self.is_half_closed = True
        if self.needs_client:
            self.abort("gone")
            return False
        self._loop.call_later(HALF_CLOSED_S, self._close_if_idle)
        # A client that has sent its last request may close that side. TLS cannot keep the other.
        return self.transport.get_extra_info("sslcontext") is None

    def pause_writing(self) -> None:
        self._http.pause_writing()

    def resume_writing(self) -> None:
        self._http.resume_writing()

    def connection_lost(self, error: Exception | None) -> None:
        if isinstance(error, TimeoutError) and not self.cut:  # the kernel's: `write_timeout_s`
            self._clients.metrics.timeouts.add(1, "write")
            self.cut = "stalled"
        self.cut = self.cut or "gone"
        self._http.connection_lost(error)
        self._closed(self)

    # What the application calls.

    def begin(self, writer: AbstractStreamWriter) -> None:
        """A request has come whole, but for its body; `writer` will write the response."""
        self._before_bytes = self._sent_bytes()
        self._writer = writer
        self.is_answering, self._begun, self._ahead_bytes = True, False, 0

    async def deliver(self, closing: bool) -> None:
        """Waits until the client has nearly all of the response, sends more, or the server stops;
        cancelled when the connection is lost. closing: whether the response is the last."""
        look_s = FIRST_LOOK_S
        while not (self._ahead_bytes or self._stopping) and self.queued_bytes() > UNSEEN_BYTES:
            if closing and self.transport.can_write_eof():
                self.transport.write_eof()  # the client need not wait for the looks
            self._look = self._loop.create_future()
            timer = self._loop.call_later(look_s, self._wake)
            try:
                await self._look
            finally:
                timer.cancel()
            look_s = min(2 * look_s, MAX_LOOK_S)

    def end(self, closing: bool) -> None:
        """The response is on its way. closing: whether it is the last."""
        self.is_answering, self._ending, self._ahead_bytes = False, closing, 0
        self._deadline_s = self._loop.time() + (
            LINGER_S if closing else self._clients.timeouts.keepalive_timeout_s
        )
        if self._stopping:
            self._loop.call_soon(self._close_if_idle)
        elif self.is_half_closed:
            self._loop.call_later(HALF_CLOSED_S, self._close_if_idle)

    def take_sent_bytes(self) -> int:
        """Bytes that were written since it was asked last."""
        sent_bytes = self._sent_bytes()
        taken, self._taken_bytes = sent_bytes - self._taken_bytes, sent_bytes
        return taken

    def hold_at_most(self, queue_bytes: int) -> None:
        """Lets about `queue_bytes` wait in the process, and as many unsent in the kernel."""
        self.transport.set_write_buffer_limits(high=queue_bytes, low=queue_bytes // 4)
        if hasattr(socket, "TCP_NOTSENT_LOWAT"):
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NOTSENT_LOWAT, queue_bytes)

    @property
    def piece_bytes(self) -> int:
        """How much of a body is written in one go: the transport keeps what the kernel does not
        take."""
        share_bytes = PIECES_BYTES // max(1, len(self._clients.connections))
        return max(MIN_PIECE_BYTES, min(MAX_PIECE_BYTES, share_bytes))

    def queued_bytes(self) -> int:
        """Bytes written but not yet acknowledged by the client's side, as far as one can see."""
        return self.transport.get_write_buffer_size() + unacked_bytes(self._socket)

    def tcp_info(self) -> TcpInfo | None:
        """The kernel's figures of the connection; None if it reports none, or none any more."""
        return read_tcp_info(self._socket)

    # How it ends.

    def check(self, now_s: float) -> None:
        """Ends the connection if its client takes too long. To be called twice a second or so."""
        if self.is_answering or now_s < self._deadline_s or self.transport.is_closing():
            return
        if self._ending:
            self.abort()
        elif self._begun:
            self._clients.metrics.timeouts.add(1, "head")
            note = "the request was not complete in time"
            self._refuse(408, "Request Timeout", note)
        else:
            self._clients.metrics.timeouts.add(1, "idle")
            self.transport.close()

    def stop(self) -> None:
        """Closes the connection as soon as no response is on its way. A request is still answered
        if the connection was accepted a moment ago."""
        self._stopping = True
        self._wake()
        if self._writer is None or self._begun:
            self._deadline_s = min(self._deadline_s, self._request_deadline_s())
        else:
            self._close_if_idle()

    def abort(self, why: str = "stopped") -> None:
        """Ends the connection now."""
        self.cut = self.cut or why
        self.transport.abort()

    def _wake(self) -> None:
        if self._look is not None and not self._look.done():
            self._look.set_result(None)

    def _refuse(self, status: int, phrase: str, note: str) -> None:
        self._clients.refused(self.address, status, note)
        self.transport.write(refusal(status, phrase))
        self.transport.close()

    def _close_if_idle(self) -> None:
        if not self.is_answering:
            self.transport.close()

    def _request_deadline_s(self) -> float:
        """When a request must have come of which the first byte comes now."""
        timeout_s = self._clients.timeouts.request_timeout_s
        return self._loop.time() + (min(timeout_s, LAST_CALL_S) if self._stopping else timeout_s)

    def _sent_bytes(self) -> int:
        """Bytes written so far, to the kernel or to the transport."""
        return self._before_bytes + (self._writer.output_size if self._writer is not None else 0)


def connection_of(request: web.BaseRequest) -> ClientConnection:
    """The connection on which a request came. Raises ConnectionResetError if it is over."""
    if request.transport is None:
        raise ConnectionResetError("the client has gone")
    connection = request.transport.get_protocol()
    assert isinstance(connection, ClientConnection)
    return connection
