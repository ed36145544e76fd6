"""The sending side of a connection: short queues, no needless copies, and a view of its progress.

Rule: of what is to be sent, little waits in this process. A body goes from where it lies to the
kernel, as fast as the client takes it.
"""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable
from contextlib import suppress
from typing import Final

from .tcpinfo import TcpInfo, read_tcp_info, unacked_bytes

SHORT_BYTES: Final = 16 * 1024
"""Bytes of a body that goes out in one piece with its head."""

PIECE_BYTES: Final = 64 * 1024
"""Bytes that are written in one go where a transport copies what the kernel does not take."""

TURN_BYTES: Final = 1 << 20
"""Bytes of one response that the kernel is given before the other connections have their turn."""

TRIPWIRE_BYTES: Final = 2048
"""Bytes left to the transport when the kernel takes no more: it tells when that changes."""


class Outlet:
    """Writes to one connection, through its transport or past it to its socket."""

    def __init__(
        self,
        transport: asyncio.Transport,
        sock: socket.socket | None,
        count: Callable[[int], None],
    ) -> None:
        """sock: the socket itself where bytes may go past the transport; None with TLS. count: is
        told how many bytes leave, as they do."""
        self._transport = transport
        self._socket = sock
        self._count = count
        self._asked = transport.get_extra_info("socket")
        self._loop = asyncio.get_running_loop()
        self.paused = False
        """Whether the transport has more than it should hold."""
        self.sent_bytes = 0
        """Bytes written so far, to the kernel or to the transport."""
        self._body = memoryview(b"")  # what is left of it
        self._then: Callable[[], None] | None = None
        self._window: tuple[float, int] | None = None  # when it began, what had arrived by then

    def hold_at_most(self, queue_bytes: int) -> None:
        """Lets about `queue_bytes` wait in the process, and as many unsent in the kernel."""
        # Not 0: a TLS transport would be paused before it has anything, and nothing resumes it.
        self._transport.set_write_buffer_limits(high=max(1, queue_bytes), low=queue_bytes // 4)
        if queue_bytes and hasattr(socket, "TCP_NOTSENT_LOWAT"):
            self._asked.setsockopt(socket.IPPROTO_TCP, socket.TCP_NOTSENT_LOWAT, queue_bytes)

    def write(self, data: bytes | memoryview) -> None:
        """Writes `data`, which is short or was waited for."""
        if not self._transport.is_closing():
            self.sent_bytes += len(data)
            self._count(len(data))
            self._transport.write(data)

    def send(self, head: bytes, body: bytes | memoryview, then: Callable[[], None]) -> None:
        """Sends `head` and `body`, and calls `then` once the transport has room again: who sends
        requests and takes no responses is not read on."""
        self._then = then
        if len(body) <= SHORT_BYTES:
            self.write(b"".join((head, body)))
            self.pump()
            return
        self._body = memoryview(body)
        sent = self._give(head, self._body)
        self._body = self._body[max(0, sent - len(head)) :]
        if sent < len(head):
            self.write(head[sent:])
        self.pump()

    def pump(self) -> None:
        """Goes on with the body, as far as the client lets it."""
        if self._then is None or self._transport.is_closing():
            return
        turn_bytes = len(self._body) - TURN_BYTES
        while self._body:
            if self.paused:
                return
            if len(self._body) <= turn_bytes:
                self._loop.call_soon(self.pump)
                return
            sent = self._give(self._body)
            if not sent:
                sent = TRIPWIRE_BYTES if self._socket is not None else PIECE_BYTES
                self.write(self._body[:sent])
            self._body = self._body[sent:]
        if self.paused:
            return
        then, self._then = self._then, None
        then()

    def _give(self, *parts: bytes | memoryview) -> int:
        """Gives the kernel as much as it takes; 0 also where all must go through the transport."""
        if self._socket is None or self._transport.get_write_buffer_size():
            return 0
        try:
            sent = self._socket.sendmsg(parts)
        except (BlockingIOError, InterruptedError):
            return 0
        except OSError:  # the client has gone
            self._transport.abort()
            return 0
        self.sent_bytes += sent
        self._count(sent)
        return sent

    def close(self, timeout_s: float) -> None:
        """Ends the connection behind what was written. The kernel forgets after `timeout_s` of
        silence what nobody here watches any more: bytes that the client does not take."""
        # Not before: a window that is nearly closed counts as silence too.
        if hasattr(socket, "TCP_USER_TIMEOUT"):
            with suppress(OSError):
                milliseconds = max(1, round(1000 * timeout_s))
                self._asked.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, milliseconds)
        self._transport.close()

    def end(self) -> bool:
        """Tells the client that nothing more comes, if all has left this process and one side can
        be closed alone; gives whether it was told."""
        if self._socket is None or self._transport.get_write_buffer_size():
            return False
        try:
            self._socket.shutdown(socket.SHUT_WR)
        except OSError:  # it has gone
            return False
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
