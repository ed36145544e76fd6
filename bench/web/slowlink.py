"""A TCP proxy in front of a server that adds the latency of a long link."""

from __future__ import annotations

import asyncio
import contextlib
import re
import threading
from collections.abc import Iterator

PIECE_BYTES = 1 << 16

MOST_PIECES = 256
"""Maximum pieces of a connection on the link in one direction; further ones wait at the sender."""

_REQUEST = re.compile(rb"(?:GET|HEAD|POST) \S+ HTTP/1\.1\r\n")


class SlowLink:
    """Delays data by half of the round trip each way, and by a whole one for the handshake of a
    connection. It also counts requests and bytes, for HTTP/1.1 without TLS."""

    def __init__(self, port: int, rtt_s: float) -> None:
        """port: the port of the server on this machine."""
        self.port = 0
        """The link's own port."""
        self.requests: list[str] = []
        """The first lines of all requests since the last `reset`."""
        self.received_bytes = 0
        """Bytes that reached the client since the last `reset`."""
        self._server_port = port
        self._rtt_s = rtt_s

    def reset(self) -> None:
        """Sets the counts to zero."""
        self.requests, self.received_bytes = [], 0

    async def serve(self) -> asyncio.Server:
        """Starts to listen."""
        server = await asyncio.start_server(self._accept, "127.0.0.1", 0)
        self.port = server.sockets[0].getsockname()[1]
        return server

    async def _accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await asyncio.sleep(self._rtt_s)
        far_reader, far_writer = await asyncio.open_connection("127.0.0.1", self._server_port)
        try:
            async with asyncio.TaskGroup() as group:
                group.create_task(self._carry(reader, far_writer, upwards=True))
                group.create_task(self._carry(far_reader, writer, upwards=False))
        except* (OSError, asyncio.CancelledError):
            pass  # either end may close the connection, and the link itself is closed at the end
        finally:
            writer.close()
            far_writer.close()

    async def _carry(
        self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, upwards: bool
    ) -> None:
        clock = asyncio.get_running_loop().time
        on_link: asyncio.Queue[tuple[float, bytes]] = asyncio.Queue(MOST_PIECES)

        async def deliver() -> None:
            while True:
                due_s, data = await on_link.get()
                await asyncio.sleep(due_s - clock())
                if not data:
                    return
                if not upwards:
                    self.received_bytes += len(data)
                writer.write(data)
                await writer.drain()

        async with asyncio.TaskGroup() as group:
            group.create_task(deliver())
            data = b"begin"
            while data:
                data = await reader.read(PIECE_BYTES)
                if upwards:
                    self.requests += [line.decode() for line in _REQUEST.findall(data)]
                await on_link.put((clock() + self._rtt_s / 2, data))
        writer.close()


@contextlib.contextmanager
def slow_link(port: int, rtt_s: float) -> Iterator[SlowLink]:
    """Runs a link to the server at `port` of this machine, in a thread of its own."""
    link, ready = SlowLink(port, rtt_s), threading.Event()
    loop: asyncio.AbstractEventLoop
    stop: asyncio.Event

    async def run() -> None:
        nonlocal loop, stop
        loop, stop = asyncio.get_running_loop(), asyncio.Event()
        server = await link.serve()
        ready.set()
        await stop.wait()
        server.close()

    thread = threading.Thread(target=lambda: asyncio.run(run()))
    thread.start()
    ready.wait()
    try:
        yield link
    finally:
        loop.call_soon_threadsafe(stop.set)
        thread.join()
