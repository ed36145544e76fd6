"""A slow link to a server: a TCP relay that passes bytes as a Link says.

The user writes a link as a rate, `8M` (bits per second; k, M, G), a rate and a latency, `8M,20ms`,
or the name of a trace, a file that server/abr/traces.py can read.

Rule: a byte stays in the server's own send queue until it has passed the link and its latency is
over. So the relay takes it from the kernel only then, and lets the kernel hold as little as it can:
what the server sees unacknowledged is what a real link would leave so. The link is one; all
connections share it.

Not modelled: loss and reordering, a limit to the queue before the link (that is the server's own),
and the way up, which takes no time. Bytes that follow the last ones so soon that the queue may not
have been empty (LULL_S) come as early as if they had been sent right behind them: a server that
keeps less in its queue than passes within the latency sees a shorter latency, not a slower link. So
do the first bytes of a connection while others keep the link at work.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import math
import re
import socket
import struct
import sys

from codec.errors import InvalidError
from server.abr.link import Link, LinkStep
from server.abr.traces import MAX_TRACE_BYTES, parse_trace

_LINK = re.compile(r"(\d+(?:\.\d+)?)([kMG]?)(?:,(\d+(?:\.\d+)?)ms)?")

_PREFIXES = {"": 1.0, "k": 1e3, "M": 1e6, "G": 1e9}

_ROUND_S = 3600.0
"""Step length of a link that never changes, seconds; any would do."""


def read_link(text: str) -> Link:
    """The link that `text` describes, see above. Raises InvalidError."""
    match = _LINK.fullmatch(text)
    if match:
        rate_bps, latency_s = float(match[1]) * _PREFIXES[match[2]], float(match[3] or 0) / 1000
        return Link([LinkStep(_ROUND_S, rate_bps, latency_s)])
    try:
        with open(text, "rb") as file:
            data = file.read(MAX_TRACE_BYTES + 1)
    except (OSError, ValueError) as error:  # ValueError: no file can have this name
        reason = error.strerror if isinstance(error, OSError) else error
        raise InvalidError(
            f"link {text!r} is neither a rate such as 8M or 8M,20ms nor a trace: {reason}"
        ) from error
    return parse_trace(data, text)


log = logging.getLogger(__name__)

MIN_BUFFER_BYTES = 4 << 10
BUFFER_S = 0.001
"""Receive buffer asked of the kernel for the server: seconds of the link at its fastest, but at
least MIN_BUFFER_BYTES. It holds half as much again. These bytes are acknowledged before
their time: 6 KiB are 16 ms of a link of 3 Mbit/s, 1.5 ms one of 100 Mbit/s."""

SEND_BUFFER_BYTES = 256 << 10
"""Send buffer of connections to the player: it holds bytes that have passed the link, as a player's
kernel does. Behind a player that reads more slowly the server waits."""

PIECE_S = 0.004
"""Time on the link of what is moved in one go, at most, seconds."""

MIN_PIECE_BYTES = 1 << 10

MIN_SLEEP_S = 0.002
"""Seconds: a task that sleeps too long moves more pieces when it wakes."""

MAX_CREDIT_S = 0.25
"""The most lateness, in seconds, that is made up for when bytes were waiting all the time."""

LULL_S = 0.003
"""Once nothing has come for so long the server's queue was empty, seconds: the kernel needs a
moment to refill the buffer."""

MAX_READ_BYTES = 64 << 10

_TCP_INFO_RTT = 68
"""Offset of the round trip in microseconds, uint32, in Linux's struct tcp_info."""


class Relay:
    """Passes every connection on to (host, port). One event loop runs it."""

    def __init__(self, link: Link, host: str, port: int) -> None:
        self._link = link
        self._target = (host, port)
        self._loop = asyncio.get_running_loop()
        self._turn = asyncio.Lock()  # fair: connections pass piece by piece
        self._free_s = 0.0  # when the last piece had passed, without latency
        self._comes_s = 0.0  # when it came out
        self._busy: set[socket.socket] = set()  # connections whose bytes wait for the link
        self._fastest_bps = max(step.rate_bps for step in link.steps)
        self._buffer_bytes = max(MIN_BUFFER_BYTES, round(self._fastest_bps / 8 * BUFFER_S))
        self.began_s: float | None = None
        """When the first connection came, by time.monotonic: the link's time 0."""
        self.down_bytes = 0
        """Bytes passed from the server to the player."""

    async def serve(self, listener: socket.socket) -> None:
        """Accepts on `listener`, which does not block, until cancelled; then cuts all
        connections."""
        async with asyncio.TaskGroup() as group:
            while True:
                player, _ = await self._loop.sock_accept(listener)
                if self.began_s is None:
                    self.began_s = self._loop.time()
                group.create_task(self._relay(player))

    def _now_s(self) -> float:
        """Seconds since the link began."""
        assert self.began_s is not None
        return self._loop.time() - self.began_s

    async def _relay(self, player: socket.socket) -> None:
        with player:
            player.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            try:
                server = await self._connect()
            except OSError as error:
                with contextlib.suppress(OSError):
                    await self._refuse(player, error)
                return
            with server:
                try:
                    async with asyncio.TaskGroup() as group:
                        group.create_task(self._pass_up(player, server))
                        group.create_task(self._pass_down(server, player))
                except* OSError as errors:
                    log.debug("link: %s", errors.exceptions[0])
                finally:
                    self._busy.discard(server)

    async def _refuse(self, player: socket.socket, error: OSError) -> None:
        """The player speaks HTTP, so it can be told what happened."""
        host, port = self._target
        reason = f"cannot connect to {host}:{port}: {error.strerror or error}"
        body = json.dumps({"error": reason}).encode()
        head = f"HTTP/1.1 502 Bad Gateway\r\nContent-Length: {len(body)}\r\nConnection: close"
        answer = f"{head}\r\nContent-Type: application/json\r\n\r\n".encode() + body
        await self._loop.sock_sendall(player, answer)
        player.shutdown(socket.SHUT_WR)
        while await self._loop.sock_recv(player, MAX_READ_BYTES):
            pass

    async def _connect(self) -> socket.socket:
        host, port = self._target
        last: OSError = OSError(f"{host} has no address")
        for family, kind, protocol, _, address in await self._loop.getaddrinfo(
            host, port, type=socket.SOCK_STREAM
        ):
            try:
                connection = await self._connect_to(family, kind, protocol, address)
                needed_bytes = self._path_bytes(connection)
                if needed_bytes > self._buffer_bytes:
                    # The server is not on this machine: so little would not fill the way to it.
                    connection.close()
                    self._buffer_bytes = needed_bytes
                    connection = await self._connect_to(family, kind, protocol, address)
                return connection
            except OSError as error:
                last = error
        raise last

    async def _connect_to(
        self, family: int, kind: int, protocol: int, address: tuple[object, ...]
    ) -> socket.socket:
        connection = socket.socket(family, kind, protocol)
        try:
            # Before the handshake, which fixes how much window is ever offered.
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, self._buffer_bytes)
            connection.setblocking(False)
            await self._loop.sock_connect(connection, address)
        except BaseException:
            connection.close()
            raise
        return connection

    def _path_bytes(self, connection: socket.socket) -> int:
        """Bytes on their way to the server and back when the link is at its fastest."""
        if sys.platform != "linux":
            return 0
        info = connection.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, _TCP_INFO_RTT + 4)
        round_trip_s: float = struct.unpack_from("=I", info, _TCP_INFO_RTT)[0] / 1e6
        return math.ceil(self._fastest_bps / 8 * round_trip_s)

    async def _pass_up(self, player: socket.socket, server: socket.socket) -> None:
        """Requests are small: they pass at once."""
        while data := await self._loop.sock_recv(player, MAX_READ_BYTES):
            await self._loop.sock_sendall(server, data)
        # The player closed its side: what the server still sends has no receiver.
        raise ConnectionResetError("the player closed the connection")

    async def _pass_down(self, server: socket.socket, player: socket.socket) -> None:
        """Takes from the server what has come out of the link."""
        entered_s = 0.0  # since when bytes have waited for the link without a break
        while True:
            waiting_bytes = _waiting_bytes(server)
            if waiting_bytes is not None:
                self._busy.add(server)
            else:
                # Seen now, but if the queue was not empty before, perhaps long on its way.
                if await self._readable(server, LULL_S):
                    now_s = self._now_s()
                    entered_s = max(entered_s, now_s - self._link.at(now_s).latency_s)
                else:
                    self._busy.discard(server)
                    await self._readable(server)
                    entered_s = self._now_s()
                continue
            # What enters behind the bytes of another connection finds the link at work.
            since_s = entered_s if self._busy == {server} else 0.0
            data = await self._piece(server, since_s, waiting_bytes)
            if not data:
                player.shutdown(socket.SHUT_WR)
                return
            self.down_bytes += len(data)
            sent_bytes = _send_some(player, data)
            if sent_bytes < len(data):
                self._busy.discard(server)
                await self._loop.sock_sendall(player, data[sent_bytes:])
                entered_s = self._now_s()  # the player held them back, not the link

    async def _piece(self, server: socket.socket, entered_s: float, waiting_bytes: int) -> bytes:
        """The next of `waiting_bytes`, once they have come out of the link; none at the end."""
        async with self._turn:
            link, now_s = self._link, self._now_s()
            late_s = now_s - link.at(now_s).latency_s - MAX_CREDIT_S
            begin_s = max(self._free_s, entered_s, late_s)
            most_bytes = max(MIN_PIECE_BYTES, round(link.at(begin_s).rate_bps / 8 * PIECE_S))
            num_bytes = min(most_bytes, waiting_bytes)
            self._free_s = passed_s = link.passed_s(begin_s, num_bytes)
            # Bytes never overtake each other.
            self._comes_s = max(self._comes_s, passed_s + link.at(passed_s).latency_s)
            if self._comes_s > now_s:
                await asyncio.sleep(max(self._comes_s - now_s, MIN_SLEEP_S))
            return server.recv(num_bytes) if num_bytes else b""

    async def _readable(self, connection: socket.socket, timeout_s: float | None = None) -> bool:
        """Returns when bytes or the end have come: True. False after `timeout_s` without."""
        ready = asyncio.Event()
        self._loop.add_reader(connection, ready.set)
        try:
            async with asyncio.timeout(timeout_s):
                await ready.wait()
        except TimeoutError:  # both, where this task woke late
            return ready.is_set()
        finally:
            self._loop.remove_reader(connection)
        return True


def _waiting_bytes(connection: socket.socket) -> int | None:
    """Bytes that wait in the kernel, as far as one read takes them: 0 at the end, None if none."""
    try:
        return len(connection.recv(MAX_READ_BYTES, socket.MSG_PEEK))
    except BlockingIOError:
        return None


def _send_some(connection: socket.socket, data: bytes) -> int:
    """How many bytes of `data` the kernel took at once."""
    try:
        return connection.send(data)
    except BlockingIOError:
        return 0
