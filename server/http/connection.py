"""Connections of clients, on which aiohttp speaks HTTP: the gate limits them, each knows what the
kernel says of it, why it ended and how much of a response has arrived, and the runner ends them.

The kernel's figures of a TCP connection.

Rule: nothing here is needed. A figure that the kernel does not report is None, or 0 bytes, and
callers must cope.
"""

from __future__ import annotations

import asyncio
import errno
import logging
import math
import socket
import struct
import sys
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from http import HTTPStatus
from typing import Any, Final

from aiohttp import web
from aiohttp.abc import AbstractAccessLogger
from aiohttp.http import HttpProcessingError
from aiohttp.http_exceptions import LineTooLong

from server.operate.admission import Admission
from server.operate.prometheus import Metrics

from .errors import RequestError
from .requestlog import NOTE

if sys.platform != "win32":
    import fcntl
    import termios

TCP_INFO_BYTES: Final = 168
"""How much of Linux's struct tcp_info is asked for: up to and with tcpi_delivery_rate."""

NOTHING_KNOWN_US: Final = 0xFFFFFFFF
"""Value of tcpi_min_rtt before the first sample, microseconds."""

SO_NWRITE: Final = 0x1024
"""macOS, sys/socket.h: bytes in the send buffer, which keeps them until they are acknowledged."""


@dataclass(frozen=True, slots=True)
class TcpInfo:
    """A connection's figures, of the kernel's own making."""

    min_rtt_s: float | None = None
    """The least round trip of late."""
    delivery_rate_bps: float | None = None
    """The newest sample of how fast bytes arrive."""


def parse_tcp_info(data: bytes) -> TcpInfo:
    """The figures in a struct tcp_info (linux/tcp.h). It has grown with the kernels, at its end: a
    shorter one lacks some."""

    def field(kind: str, offset: int) -> int | None:
        if offset + struct.calcsize(kind) > len(data):
            return None
        number: int = struct.unpack_from(kind, data, offset)[0]
        return number

    rtt_us = field("=I", 148)
    bytes_per_s = field("=Q", 160)
    return TcpInfo(
        min_rtt_s=None if rtt_us in (None, NOTHING_KNOWN_US) else rtt_us / 1e6,
        # 0 until there is a sample.
        delivery_rate_bps=8.0 * bytes_per_s if bytes_per_s else None,
    )


def read_tcp_info(sock: Any) -> TcpInfo | None:
    """The figures of `sock`, a socket or asyncio's stand-in for one; None where there are none."""
    if sys.platform != "linux":
        return None
    try:
        return parse_tcp_info(sock.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, TCP_INFO_BYTES))
    except OSError:  # it was closed meanwhile, or is not TCP
        return None


def unacked_bytes(sock: Any, platform: str = sys.platform) -> int:
    """Bytes that `sock` holds until they are acknowledged. 0 for a closed socket, and on kernels
    that do not report it: there, bytes that have left the process count as acknowledged.

    Linux's ioctl counts exactly those. tcpi_bytes_acked says no more, and counts the heads of HTTP
    chunks, which the session does not know; so it is not what a play goes by.
    """
    number = 0
    try:
        if platform == "linux":
            packed = fcntl.ioctl(sock.fileno(), termios.TIOCOUTQ, bytes(4))
            (number,) = struct.unpack("=i", packed)
        elif platform == "darwin":
            number = sock.getsockopt(socket.SOL_SOCKET, SO_NWRITE)
    except (OSError, ValueError):  # it was closed meanwhile
        return 0
    return number


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
MAX_PIECE_BYTES: Final = 1024 * 1024

UNSEEN_BYTES: Final = 64 * 1024
"""Unacknowledged bytes with which a response counts as delivered: about what the client's kernel
may hold of it unseen, too."""

FIRST_LOOK_S: Final = 0.005
MAX_LOOK_S: Final = 0.5
"""Seconds until a connection first asks the kernel what was acknowledged, and most between two."""

LINGER_S: Final = 2.0
"""Seconds for the rest of a request whose answer did not need it."""

LAST_CALL_S: Final = 0.5
"""Seconds for the first request of a client that was accepted just before the server stopped."""

STOP_LOOK_S: Final = 0.01
"""How often it is looked whether a stopping server has done its work, seconds."""

QUIET_S: Final = 60.0
"""Seconds between two lines that say that descriptors are out."""

log = logging.getLogger(__name__)


def is_our_fault(record: logging.LogRecord) -> bool:
    """Whether a record of aiohttp's is about this server, and not about a client."""
    error = record.exc_info[1] if record.exc_info else None
    return not isinstance(error, HttpProcessingError | ConnectionError | web.RequestPayloadError)


log.addFilter(is_our_fault)


class NoDescriptors(logging.Filter):
    """Has asyncio say once in QUIET_S that there is no descriptor for another client; it tries
    hundreds of times a second."""

    _said_s = -math.inf

    def filter(self, record: logging.LogRecord) -> bool:
        error = record.exc_info[1] if record.exc_info else None
        if isinstance(error, OSError) and error.errno in (errno.EMFILE, errno.ENFILE):
            if record.created < self._said_s + QUIET_S:
                return False
            self._said_s = record.created
        return True


logging.getLogger("asyncio").addFilter(NoDescriptors())


class Connection(web.RequestHandler):
    """aiohttp's protocol of a connection, within the limits of connections."""

    def __init__(self, server: web.Server, runner: Runner) -> None:
        super().__init__(server, loop=asyncio.get_running_loop(), **runner.options)
        self._runner = runner
        self._address: str | None = None  # where it is counted
        self.cut = ""
        """Why it is over: "gone" or "stalled"; empty while it is not."""
        self.is_new = True
        """Whether nothing has come yet."""
        self._news = asyncio.Event()  # more has come, or the client has gone

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport
        address = str(transport.get_extra_info("peername")[0])
        refused = self._runner.admission.admit(address)
        if refused is not None:
            self._runner.metrics.refused.add(1, f"connection_{refused}")
            self.refuse(429, "Retry-After: 5")
            return
        self._address = address
        self._runner.connections.add(self)
        self._socket: Any = transport.get_extra_info("socket")
        # A piece that the kernel does not take is enough to wait for.
        transport.set_write_buffer_limits(high=QUEUE_BYTES)
        super().connection_made(transport)

    def data_received(self, data: bytes) -> None:
        self.is_new = False
        self._news.set()
        super().data_received(data)

    def connection_lost(self, exc: BaseException | None) -> None:
        if self._address is None:
            return
        self._runner.admission.release(self._address)
        self._runner.connections.discard(self)
        self.cut = "gone"
        if isinstance(exc, TimeoutError):  # the kernel's, see `bound_connections`
            self._runner.metrics.timeouts.add(1, "write")
            self.cut = "stalled"
        super().connection_lost(exc)
        self._news.set()

    def refuse(self, status: int, *fields: str) -> None:
        """Answers without a body and without aiohttp, and ends the connection."""
        first = f"HTTP/1.1 {status} {HTTPStatus(status).phrase}"
        lines = (first, *fields, "Content-Length: 0", "Connection: close", "", "")
        self._transport.write("\r\n".join(lines).encode())
        self._transport.close()

    def abort(self) -> None:
        """Drops the connection, with what the client has not taken."""
        self._transport.abort()

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
        error = RequestError(status, request[NOTE], self._runner.headers)
        error.force_close()
        raise error

    # What a response asks.

    @property
    def piece_bytes(self) -> int:
        """How much of a body is written in one go: the transport keeps what the kernel does not
        take."""
        share_bytes = PIECES_BYTES // max(1, self._runner.admission.num_held)
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
        """Waits until the client has nearly all that was written. Raises ConnectionResetError if
        the client has gone. closing: whether it is the last response."""
        look_s = FIRST_LOOK_S
        while self.queued_bytes() > UNSEEN_BYTES:
            if closing and self._there.can_write_eof():
                self._there.write_eof()  # the client need not wait for the looks
            self._news.clear()
            with suppress(TimeoutError):
                async with asyncio.timeout(look_s):
                    await self._news.wait()
            look_s = min(2 * look_s, MAX_LOOK_S)

    @property
    def _there(self) -> asyncio.Transport:
        if self.transport is None:
            raise ConnectionResetError("the client has gone")
        return self.transport


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


class Gate(web.Server):
    """The server of an application, with a Connection for each client."""

    def __init__(self, inner: web.Server, runner: Runner) -> None:
        """inner: of the application."""
        super().__init__(inner.request_handler, request_factory=inner.request_factory)
        self._runner = runner

    def __call__(self) -> Connection:
        return Connection(self, self._runner)


class Runner(web.AppRunner):
    """Runs an application, and has what its connections share. It is an AppRunner for aiohttp's
    worker of gunicorn, too."""

    def __init__(
        self,
        app: web.Application,
        admission: Admission,
        metrics: Metrics,
        headers: Mapping[str, str],
        access_log_class: type[AbstractAccessLogger],
        keepalive_timeout_s: float,
        stop_s: float,
    ) -> None:
        """headers: of every response. keepalive_timeout_s: for a whole request, from the connection
        or the response before it on. stop_s: for all responses when the server stops."""
        super().__init__(app)
        self.admission = admission
        self.metrics = metrics
        self.headers = headers
        self.connections = set[Connection]()
        """The admitted connections, until they end."""
        self.options: Mapping[str, Any] = {
            "access_log": log,
            "access_log_class": access_log_class,
            "logger": log,
            "keepalive_timeout": keepalive_timeout_s,
            "lingering_time": LINGER_S,
            "tcp_keepalive": False,
            "max_line_size": MAX_TARGET_BYTES,
            "max_field_size": MAX_FIELD_BYTES,
            "max_headers": MAX_FIELDS,
            "auto_decompress": False,
        }
        """The options of web.RequestHandler."""
        self._stop_s = stop_s

    @property
    def server(self) -> Gate:
        """What makes the protocols of new connections; there is none before `setup`."""
        return self._gate

    async def setup(self) -> None:
        await super().setup()
        inner = super().server
        assert inner is not None
        self._gate = Gate(inner, self)

    async def shutdown(self) -> None:
        """Has plays end, and waits until all that was asked is answered and has arrived."""
        await super().shutdown()
        gate, connections = self._gate, self.connections
        with suppress(TimeoutError):
            async with asyncio.timeout(self._stop_s):
                with suppress(TimeoutError):
                    async with asyncio.timeout(LAST_CALL_S):
                        await _until(lambda: not any(one.is_new for one in connections))
                gate.pre_shutdown()  # those that are idle
                await gate.shutdown(self._stop_s)
                await _until(lambda: not connections)
        await gate.shutdown(STOP_LOOK_S)  # who did not take it in time
        for one in connections:
            one.abort()
        await asyncio.sleep(0)  # for the ends of these


async def _until(done: Callable[[], bool]) -> None:
    while not done():  # noqa: ASYNC110
        await asyncio.sleep(STOP_LOOK_S)
