"""A slow link to a server: a TCP relay on this machine that passes bytes as a Link says.

Rule: the link is one; all connections share it. Buffers are bounded, so a player that does not read
holds the server back as a real link does.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import socket
import threading
from collections import deque

from codec.errors import SwingsError
from server.abr.link.link import Link

log = logging.getLogger(__name__)

SOCKET_BUFFER_BYTES = 64 << 10
"""Of the relay's sockets. The usual ones hold almost a megabyte, seconds of a slow link."""

MIN_PIECE_BYTES, MAX_PIECE_BYTES = 2 << 10, 64 << 10
PIECE_S = 0.004
"""Time on the link of what is moved in one go, seconds."""

LOOKAHEAD_S = 0.004
"""The next piece is fetched this long before the link is free, seconds: tasks wake up late."""

MAX_CREDIT_S = 0.25
"""The most lateness, in seconds, that is made up for when bytes were waiting all the time."""

AT_ONCE_S = 0.001
"""A read that took less time than this, in seconds, found bytes that were waiting already."""


class RelayError(SwingsError):
    """The relay cannot start."""


class _Delay:
    """The bytes of one connection that have passed the link, until their latency is over."""

    def __init__(self) -> None:
        self._pieces: deque[tuple[float, bytes]] = deque()
        self._changed = asyncio.Condition()
        self._held_bytes = 0

    async def put(self, ready_s: float, data: bytes, room_bytes: int) -> bool:
        """Adds `data` once fewer than `room_bytes` are held; gives whether that had to wait."""
        async with self._changed:
            full = self._held_bytes >= room_bytes
            await self._changed.wait_for(lambda: self._held_bytes < room_bytes)
            if self._pieces:
                ready_s = max(ready_s, self._pieces[-1][0])  # bytes never overtake each other
            self._pieces.append((ready_s, data))
            self._held_bytes += len(data)
            self._changed.notify_all()
            return full

    async def first(self) -> tuple[float, bytes]:
        """The oldest piece, which stays until `drop`."""
        async with self._changed:
            await self._changed.wait_for(lambda: bool(self._pieces))
            return self._pieces[0]

    async def drop(self) -> None:
        async with self._changed:
            self._held_bytes -= len(self._pieces.popleft()[1])
            self._changed.notify_all()


class Relay:
    """Listens on this machine and passes every connection on to (host, port), with a thread of its
    own. Use it with `with`, or close it."""

    def __init__(self, link: Link, host: str, port: int) -> None:
        self._link = link
        self._target = (host, port)
        self._free_s = 0.0
        self._origin_s = 0.0
        self._loop = asyncio.new_event_loop()
        self._started = threading.Event()
        self._stop = asyncio.Event()
        self._failure: OSError | None = None
        self._connections: set[asyncio.Task[None]] = set()
        self.address = ("", 0)
        """Where to connect instead of to the server."""
        self.down_bytes = 0
        """Bytes passed from the server to the player."""
        self._thread = threading.Thread(target=self._run, name="link", daemon=True)
        self._thread.start()
        self._started.wait()
        if self._failure is not None:
            self._thread.join()
            raise RelayError(f"the link cannot listen: {self._failure}") from self._failure

    def __enter__(self) -> Relay:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def close(self) -> None:
        """Cuts all connections and ends the thread; closing twice is the same as once."""
        with contextlib.suppress(RuntimeError):  # the loop is closed already
            self._loop.call_soon_threadsafe(self._stop.set)
        self._thread.join()

    def _run(self) -> None:
        try:
            self._loop.run_until_complete(self._serve())
        except OSError as error:
            self._failure = error
        finally:
            self._loop.run_until_complete(self._loop.shutdown_asyncgens())
            self._loop.close()
            self._started.set()

    async def _serve(self) -> None:
        listener = socket.create_server(("127.0.0.1", 0))
        # Inherited by accepted connections.
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SOCKET_BUFFER_BYTES)
        server = await asyncio.start_server(self._accept, sock=listener)
        self.address = listener.getsockname()
        self._origin_s = self._loop.time()
        self._started.set()
        await self._stop.wait()
        server.close()
        for connection in tuple(self._connections):
            connection.cancel()
        await asyncio.gather(*self._connections, return_exceptions=True)
        await server.wait_closed()

    def _now_s(self) -> float:
        """Seconds since the link began."""
        return self._loop.time() - self._origin_s

    async def _accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        self._connections.add(task)
        try:
            await self._connect(reader, writer)
        except (OSError, asyncio.CancelledError):
            pass  # either end went away, or the relay closes: both sides are cut below
        finally:
            self._connections.discard(task)
            writer.transport.abort()

    async def _connect(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        host, port = self._target
        try:
            up_reader, up_writer = await self._open(host, port)
        except OSError as error:
            # The player speaks HTTP, so it can be told what happened.
            reason = f"cannot connect to {host}:{port}: {error.strerror or error}"
            body = json.dumps({"error": reason}).encode()
            head = f"HTTP/1.1 502 Bad Gateway\r\nContent-Length: {len(body)}\r\nConnection: close"
            writer.write(f"{head}\r\nContent-Type: application/json\r\n\r\n".encode() + body)
            await writer.drain()
            writer.write_eof()
            await reader.read()
            return
        writer.transport.set_write_buffer_limits(high=SOCKET_BUFFER_BYTES)
        try:
            async with asyncio.TaskGroup() as group:
                group.create_task(self._pass_up(reader, up_writer))
                group.create_task(self._pass_down(up_reader, writer))
        except* OSError as errors:
            log.debug("link: %s", errors.exceptions[0])
        finally:
            up_writer.transport.abort()

    async def _open(
        self, host: str, port: int
    ) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
        last: OSError = OSError(f"{host} has no address")
        for family, kind, protocol, _, address in await self._loop.getaddrinfo(
            host, port, type=socket.SOCK_STREAM
        ):
            connection = socket.socket(family, kind, protocol)
            try:
                # Before the handshake, which fixes how much window is ever offered.
                connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, SOCKET_BUFFER_BYTES)
                connection.setblocking(False)
                await self._loop.sock_connect(connection, address)
                return await asyncio.open_connection(sock=connection, limit=MAX_PIECE_BYTES)
            except OSError as error:
                connection.close()
                last = error
            except BaseException:
                connection.close()
                raise
        raise last

    async def _pass_up(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Requests are small: they pass at once."""
        while data := await reader.read(MAX_PIECE_BYTES):
            writer.write(data)
            await writer.drain()
        # The player closed its side: nobody is left to take what the server still sends.
        raise ConnectionResetError("the player closed the connection")

    async def _pass_down(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        delay = _Delay()
        async with asyncio.TaskGroup() as group:
            group.create_task(self._throttle(reader, delay))
            group.create_task(self._deliver(delay, writer))
        writer.write_eof()

    async def _throttle(self, reader: asyncio.StreamReader, delay: _Delay) -> None:
        """Takes from the server what the link can pass; an empty piece marks the end."""
        held_back = False
        while True:
            step = self._link.at(self._now_s())
            piece_bytes = round(step.rate_bps / 8 * PIECE_S)
            piece_bytes = min(max(piece_bytes, MIN_PIECE_BYTES), MAX_PIECE_BYTES)
            asked_s = self._now_s()
            data = await reader.read(piece_bytes)
            now_s = self._now_s()
            # Bytes that were waiting could have passed since the link was free, had this task woken
            # in time. Bytes that came just now, or that the player held back, could not.
            waited = now_s - asked_s < AT_ONCE_S and not held_back
            begin_s = max(self._free_s, now_s - MAX_CREDIT_S if waited else now_s)
            self._free_s = passed_s = self._link.passed_s(begin_s, len(data))
            latency_s = self._link.at(passed_s).latency_s
            room_bytes = SOCKET_BUFFER_BYTES + round(step.rate_bps / 8 * latency_s)
            held_back = await delay.put(passed_s + latency_s, data, room_bytes)
            if not data:
                return
            await asyncio.sleep(passed_s - LOOKAHEAD_S - self._now_s())

    async def _deliver(self, delay: _Delay, writer: asyncio.StreamWriter) -> None:
        while True:
            ready_s, data = await delay.first()
            await asyncio.sleep(ready_s - self._now_s())
            if not data:
                return
            writer.write(data)
            self.down_bytes += len(data)
            await writer.drain()
            await delay.drop()
