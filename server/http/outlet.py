"""The sending side of a connection: short queues, no needless copies, and a view of its progress.

Rule: of what is to be sent, little waits in this process. The kernel takes files in memory by
itself; other bodies go piece by piece, as fast as the client takes them.
"""

from __future__ import annotations

import asyncio
import os
import socket
from collections.abc import Callable
from typing import Final

from .memoryfile import SUPPORTED
from .response import Body, FilePart
from .tcpinfo import TcpInfo, read_tcp_info, unacked_bytes

PIECE_BYTES: Final = 64 * 1024
"""Bytes of a body in memory that are written in one go; what the kernel does not take is copied."""

TURN_BYTES: Final = 1 << 20
"""Bytes of one response that the kernel is given before the other connections have their turn."""

TRIPWIRE_BYTES: Final = 2048
"""Bytes left to the transport when the kernel takes no more: it tells when that changes."""

_MORE = getattr(socket, "MSG_MORE", 0)


class Outlet:
    """Writes to one connection, through its transport or past it to its socket."""

    def __init__(self, transport: asyncio.Transport, sock: socket.socket | None) -> None:
        """sock: the socket itself where bytes may go past the transport; None with TLS."""
        self._transport = transport
        self._socket = sock if SUPPORTED else None
        self._asked = transport.get_extra_info("socket")
        self._loop = asyncio.get_running_loop()
        self.paused = False
        """Whether the transport has more than it should hold."""
        self.sent_bytes = 0
        """Bytes written so far, to the kernel or to the transport."""
        self._body: Body = b""
        self._at = 0
        self._stop = 0
        self._then: Callable[[], None] | None = None
        self._window: tuple[float, int] | None = None  # when it began, what had arrived by then
        self.hold_at_most(0)

    def hold_at_most(self, queue_bytes: int) -> None:
        """Lets about `queue_bytes` wait in the process, and as many unsent in the kernel."""
        self._transport.set_write_buffer_limits(high=queue_bytes, low=queue_bytes // 4)
        if queue_bytes and hasattr(socket, "TCP_NOTSENT_LOWAT"):
            self._asked.setsockopt(socket.IPPROTO_TCP, socket.TCP_NOTSENT_LOWAT, queue_bytes)

    def write(self, data: bytes | memoryview) -> None:
        """Writes `data`, which is short or was waited for."""
        if not self._transport.is_closing():
            self.sent_bytes += len(data)
            self._transport.write(data)

    def send(self, head: bytes, body: Body, then: Callable[[], None]) -> None:
        """Sends `head` and `body`, and calls `then` once nothing of them is left here. The
        transport may hold a little still."""
        size = len(body)
        if size <= PIECE_BYTES and not isinstance(body, FilePart):
            self.write(b"".join((head, body)))
            then()
            return
        past = isinstance(body, FilePart) and self._socket is not None
        if past and not self._transport.get_write_buffer_size():
            self._write_past(head)
        else:
            self.write(head)
        start = body.start if isinstance(body, FilePart) else 0
        self._body, self._at, self._stop, self._then = body, start, start + size, then
        self.pump()

    def _write_past(self, head: bytes) -> None:
        """Gives the kernel `head`, which the body follows in the same packet."""
        assert self._socket is not None
        try:
            count = self._socket.send(head, _MORE)
        except (BlockingIOError, InterruptedError):
            count = 0
        except OSError:
            self._transport.abort()
            return
        self.sent_bytes += count
        if count < len(head):
            self.write(head[count:])

    def pump(self) -> None:
        """Goes on with the body, as far as the client lets it."""
        if self._then is None or self._transport.is_closing():
            return
        body, turn = self._body, self._at + TURN_BYTES
        while self._at < self._stop:
            if self.paused:
                return
            if self._at >= turn:
                self._loop.call_soon(self.pump)
                return
            if not isinstance(body, FilePart):
                piece = memoryview(body)[self._at : min(self._at + PIECE_BYTES, self._stop)]
                self._at += len(piece)
                self.write(piece)
            elif self._socket is None or not self._send_file(body, self._socket):
                long = self._socket is None
                stop = min(self._at + (PIECE_BYTES if long else TRIPWIRE_BYTES), self._stop)
                piece = memoryview(body.file.read(self._at, stop))
                self._at = stop
                self.write(piece)
        then, self._then, self._body = self._then, None, b""
        then()

    def _send_file(self, body: FilePart, sock: socket.socket) -> bool:
        """Gives the kernel more of `body`; False when it takes nothing now."""
        if self._transport.get_write_buffer_size():
            return False
        try:
            count = os.sendfile(
                sock.fileno(),
                body.file.descriptor,
                self._at,
                min(self._stop - self._at, TURN_BYTES),
            )
        except (BlockingIOError, InterruptedError):
            return False
        except OSError:  # the client has gone
            self._transport.abort()
            self._at = self._stop
            return True
        self._at += count
        self.sent_bytes += count
        return True

    def queued_bytes(self) -> int:
        """Bytes written but not yet acknowledged by the client's side, as far as one can see."""
        return self._transport.get_write_buffer_size() + unacked_bytes(self._asked)

    def tcp_info(self) -> TcpInfo | None:
        """What the kernel knows of the connection; None where it does not tell, or not any more."""
        return read_tcp_info(self._asked)

    def has_stalled(self, now_s: float, timeout_s: float, least_bytes: float) -> bool:
        """Whether the client has had something to take for all of the last `timeout_s`, and took
        less than `least_bytes` of it. To be asked more often than that."""
        queued_bytes = self.queued_bytes()
        if not queued_bytes and self._then is None:
            self._window = None
            return False
        arrived_bytes = self.sent_bytes - queued_bytes
        if self._window is None:
            self._window = now_s, arrived_bytes
        began_s, before_bytes = self._window
        if now_s - began_s < timeout_s:
            return False
        self._window = now_s, arrived_bytes
        return arrived_bytes - before_bytes < least_bytes
