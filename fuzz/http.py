"""Fuzzing of the server, from the bytes of a client to the bytes of its responses.

The property under test: whatever a client sends, it receives well-formed responses in the order of
its requests, never a 500, and never a byte of a file outside a stream. The server is complete
except for its sockets: the bytes go through memory.

How to run it, in the environment of fuzz/codec.py with the server's dependencies:

    mkdir -p /tmp/found /tmp/requests
    /tmp/fuzz/bin/python -m fuzz.httpseed /tmp/requests
    /tmp/fuzz/bin/python -m fuzz http /tmp/found /tmp/requests -max_total_time=600 -max_len=4096

`tests/server/clients/test_fuzz.py` sends the same requests, and variations of them.
"""

from __future__ import annotations

import asyncio
import re
import socket
import tempfile
from pathlib import Path

import numpy as np

from codec.slice import Slice
from codec.stream import StreamWriter
from server.app import Application
from server.clients.connection import READ_BYTES, ClientConnection
from server.exchange.exchange import CLIENT_GONE, Exchange
from server.library import Library
from server.state.config import ServerConfig
from server.state.serverstate import ServerState

from .seed import made_manifest, made_splats

SECRET = b"not for you: 9c41e7"
"""Content of the files around the stream."""

QUIET_TURNS = 8
"""Turns of the event loop after which no further request begins."""

LEAVE_S = 0.5
"""Time after which a client leaves, because a paused play has no end."""

GO_ON = b"HTTP/1.1 100 Continue\r\n\r\n"

_HEAD = re.compile(
    rb"HTTP/1\.[01] ([1-5][0-9]{2}) [A-Za-z -]+\r\n((?:[A-Za-z-]+: [\x20-\x7e]*\r\n)*)\r\n"
)
_CHUNK = re.compile(rb"([0-9a-f]{1,8})\r\n")


class MemoryTransport(asyncio.Transport):
    """Keeps the bytes sent, and never blocks."""

    def __init__(self, sock: socket.socket) -> None:
        """sock: a socket on which the server may set options."""
        super().__init__({"socket": sock})
        self.sent = bytearray()
        self._closing = False
        self._protocol: asyncio.BaseProtocol | None = None

    def set_protocol(self, protocol: asyncio.BaseProtocol) -> None:
        self._protocol = protocol

    def get_protocol(self) -> asyncio.BaseProtocol:
        assert self._protocol is not None
        return self._protocol

    def set_write_buffer_limits(self, high: int | None = None, low: int | None = None) -> None:
        pass

    def get_write_buffer_size(self) -> int:
        return 0

    def write(self, data: bytes | bytearray | memoryview) -> None:
        self.sent += data

    def is_closing(self) -> bool:
        return self._closing

    def close(self) -> None:
        self._closing = True

    def abort(self) -> None:
        self._closing = True

    def pause_reading(self) -> None:
        pass

    def resume_reading(self) -> None:
        pass


class NotingApplication(Application):
    """Keeps the finished exchanges."""

    def __init__(self, state: ServerState) -> None:
        super().__init__(state)
        self.done: list[Exchange] = []

    def finished(self, exchange: Exchange, now_s: float) -> None:
        super().finished(exchange, now_s)
        self.done.append(exchange)


class Served:
    """A small stream with secrets around it, and clients that connect one after the other."""

    def __init__(self, folder: Path) -> None:
        root = folder / "root"
        stream = root / "walk"
        manifest = made_manifest()
        with StreamWriter.create(stream, manifest) as writer:
            for birth in range(1 - manifest.swin_size, 6):
                splats = made_splats(manifest.slice_size, manifest.sh_degree)
                writer.append(Slice(birth, splats, np.zeros(len(splats), np.uint8)))
        for place in (folder, root, stream, stream / "segments"):
            (place / "secret.png").write_bytes(SECRET)
        self._runner = asyncio.Runner()
        self.app = self._runner.run(self._start(root))
        self._socket = socket.socket()

    async def _start(self, root: Path) -> NotingApplication:
        config = ServerConfig(live_idle_s=0.05)
        library = Library(root, config.refresh_s)
        await library.look()
        assert library.streams, library.broken
        return NotingApplication(ServerState(library, config))

    def close(self) -> None:
        self._socket.close()
        self._runner.close()

    def answers(self, *pieces: bytes) -> list[int]:
        """Statuses of the responses to a client that sends `pieces`. Raises AssertionError if the
        property is violated."""
        self.app.done.clear()
        data = self._runner.run(self._talk(pieces))
        assert SECRET not in data
        return check_responses(data, self.app.done)

    async def _talk(self, pieces: tuple[bytes, ...]) -> bytes:
        transport, app = MemoryTransport(self._socket), self.app
        connection = ClientConnection(app.clients, "127.0.0.1", lambda _: None)
        transport.set_protocol(connection)
        connection.connection_made(transport)
        loop = asyncio.get_running_loop()
        until_s = loop.time() + LEAVE_S
        for piece in pieces:
            for start in range(0, len(piece), READ_BYTES):
                if not transport.is_closing():
                    part = piece[start : start + READ_BYTES]
                    connection.get_buffer(-1)[: len(part)] = part
                    connection.buffer_updated(len(part))
            # Objects are read in threads, and plays read the clock.
            await asyncio.sleep(0)
            quiet = 0
            while quiet < QUIET_TURNS and loop.time() < until_s:
                quiet = 0 if connection.is_answering else quiet + 1
                await asyncio.sleep(0.0002 if connection.is_answering else 0)
        for _ in range(QUIET_TURNS):  # for refusals, also if the time is over
            await asyncio.sleep(0)
        sent = bytes(transport.sent)
        connection.eof_received()
        connection.connection_lost(None)
        await asyncio.gather(
            *asyncio.all_tasks() - {asyncio.current_task()}, return_exceptions=True
        )
        return sent


def check_responses(data: bytes, done: list[Exchange]) -> list[int]:
    """Statuses of the responses in `data`, which must be the responses to `done`, in order."""
    statuses: list[int] = []
    for exchange in done:
        while True:
            head = _HEAD.match(data)
            if head is None and exchange.status == CLIENT_GONE:
                assert exchange is done[-1], "a client leaves once"
                return statuses
            assert head is not None, data[:200]
            data = data[head.end() :]
            status = int(head[1])
            if status != 100:
                break
        assert status != 500, exchange
        assert exchange.status in (status, CLIENT_GONE), exchange
        statuses.append(status)
        whole, data = _body(head, data, status, exchange.method)
        assert whole or (exchange.status == CLIENT_GONE and exchange is done[-1]), exchange
    # A client that received a 100 may still leave.
    assert data in (b"", GO_ON), data[:200]
    return statuses


def _body(head: re.Match[bytes], data: bytes, status: int, method: str) -> tuple[bool, bytes]:
    """Whether a body is complete, and the data after it."""
    lines = [line.split(b": ", 1) for line in head[2].split(b"\r\n")[:-1]]
    fields = {name.lower(): value for name, value in lines}
    assert len(fields) == len(lines), "a field stands there twice"
    if status in (204, 304) or method == "HEAD":
        return True, data
    if b"transfer-encoding" not in fields:
        if b"content-length" not in fields:  # HTTP/1.0: to the end of the connection
            assert head[0].startswith(b"HTTP/1.0 ")
            return True, b""
        length = int(fields[b"content-length"])
        return len(data) >= length, data[length:]
    while chunk := _CHUNK.match(data):
        length, data = int(chunk[1], 16), data[chunk.end() :]
        if len(data) < length + 2:
            return False, b""
        assert data[length : length + 2] == b"\r\n"
        data = data[length + 2 :]
        if not length:
            return True, data
    assert not data, data[:200]
    return False, data


_served: Served | None = None


def test_one_input(data: bytes) -> None:
    """Sends an input; its first byte gives the number of pieces into which the rest is cut."""
    global _served
    if _served is None:
        _served = Served(Path(tempfile.mkdtemp(prefix="fuzz-http-")))
    if data:
        size = max(1, (len(data) - 1) // (1 + data[0] % 4))
        pieces = [data[start : start + size] for start in range(1, len(data), size)]
        _served.answers(*pieces)
