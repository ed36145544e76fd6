"""One connection of a client: requests in, responses out, one after the other.

Rule: whatever a client sends or does not send, it costs a bounded amount of memory for a bounded
time, and never more than its own connection.
"""

from __future__ import annotations

import asyncio
import re
import socket
import time
from collections.abc import Coroutine
from dataclasses import replace
from http import HTTPStatus
from typing import Any, Final

from .errors import RequestError
from .outlet import PIECE_BYTES, Outlet
from .request import HEAD_END, MAX_HEAD_BYTES, HeadParser, Request
from .response import (
    AnyResponse,
    Response,
    StreamedResponse,
    error_response,
    fields_text,
    whole_fields,
)
from .site import Exchange, Site
from .tcpinfo import TcpInfo

CLIENT_GONE: Final = 499
"""Counted for a response that its client did not take to the end; nobody receives it."""

LINGER_S: Final = 2.0
"""Seconds that a connection is read on after its last response: one that is closed with unread
bytes takes the response with it."""

LAST_CALL_S: Final = 0.5
"""Seconds for the first request of who was accepted just before the server stopped."""

READ_AHEAD_BYTES: Final = MAX_HEAD_BYTES
"""Bytes of further requests that are kept while one is answered."""

TURN_REQUESTS: Final = 16
"""Requests of one client that are answered before the other connections have their turn."""

_BEGIN = re.compile(rb"[A-Za-z]|\r\Z")
"""What the first byte of a request is; an empty line may come before it."""


_INCOMING: Final = memoryview(bytearray(64 * 1024))
"""Where bytes come in, of one connection after the other: each takes them before the next reads."""


class HttpConnection(asyncio.BufferedProtocol):
    """Speaks HTTP/1.1 with one client."""

    def __init__(self, site: Site, sock: socket.socket | None, address: str) -> None:
        """sock: the connection's own socket; None with TLS, where all bytes go through the
        transport. address: of the client."""
        self._site = site
        self._socket = sock
        self.address = address
        self._parser = HeadParser(site.max_body_bytes)
        self._buffer = bytearray()
        self._searched = 0  # bytes of the buffer that hold no end of a head
        self._awaited: Request | None = None  # its body is still to come
        self._exchange: Exchange | None = None
        self._task: asyncio.Task[None] | None = None
        self._writer: _Writer | None = None
        self._keep_alive = True
        self._lingers = False
        self._ended = False  # the client sends no more
        self._reading = True
        self._due = False  # the loop will read requests from the buffer
        self._fresh = True  # whether no request has come yet
        self._begun = False  # whether a part of one has come since the last
        self.began = False
        """Whether there was a connection, after any handshake; if so, it tells its end itself."""
        self.cut = ""
        self._deadline_s = 0.0

    # What asyncio calls.

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self.began = True
        self._transport = transport
        self._loop = asyncio.get_running_loop()
        self._outlet = Outlet(transport, self._socket, self._site.sent)
        self._outlet.hold_at_most(0)  # may pause it at once: TLS has greetings of its own
        self._deadline_s = self._request_deadline_s()
        self._site.connections.add(self)

    def get_buffer(self, sizehint: int) -> memoryview:
        return _INCOMING

    def buffer_updated(self, nbytes: int) -> None:
        if self._lingers:
            return
        if not self._begun:
            # From the first byte on, whatever trickles in later.
            self._begun = True
            self._deadline_s = self._request_deadline_s()
        self._buffer += _INCOMING[:nbytes]
        if self._exchange is None:
            self._read_requests()
        waits = self._exchange is not None or self._due
        if waits and len(self._buffer) > READ_AHEAD_BYTES and self._reading:
            self._reading = False
            self._transport.pause_reading()

    def eof_received(self) -> bool:
        self._ended = True
        if self._writer is not None:
            self.abort("gone")  # who plays has left; nobody waits for the rest
        # Who has sent the last request may close that side. TLS cannot keep the other one.
        return (self._exchange is not None or self._due) and self._socket is not None

    def pause_writing(self) -> None:
        self._outlet.paused = True

    def resume_writing(self) -> None:
        self._outlet.paused = False
        if self._writer is not None:
            self._writer.resume()
        self._outlet.pump()

    def connection_lost(self, error: Exception | None) -> None:
        self.cut = self.cut or "gone"
        if self._writer is None:  # else whoever writes has something to say of it
            self._finish_exchange(CLIENT_GONE)
        if self._task is not None:
            self._task.cancel()
        self._site.connections.discard(self)
        if not self._site.connections:
            self._site.emptied.set()
        self._site.closed(self.address)

    # Reading.

    def _read_requests(self) -> None:
        """Answers the requests in the buffer, until one takes its time or others have a turn."""
        self._due = False
        for _ in range(TURN_REQUESTS):
            if self._exchange is not None or self._lingers or self._transport.is_closing():
                return
            try:
                request = self._next_request()
            except RequestError as error:
                self._keep_alive = False
                self._exchange = exchange = Exchange(self.address, self._loop.time())
                exchange.note = str(error)
                self._send(error_response(error.status, str(error), error.headers))
                return
            if request is None:
                if self._ended:
                    self._close()
                return
            self._answer(request)
            if not self._buffer:
                return

    def _next_request(self) -> Request | None:
        """The next request of the buffer; None while it is not whole."""
        buffer = self._buffer
        request = self._awaited
        if request is None:
            while buffer.startswith(b"\r\n"):  # RFC 9112, section 2.2
                del buffer[:2]
            if buffer and not _BEGIN.match(buffer):
                raise RequestError(400, "the request is not HTTP")
            end = buffer.find(HEAD_END, self._searched)
            if end < 0 or end > MAX_HEAD_BYTES:
                if len(buffer) > MAX_HEAD_BYTES:
                    raise RequestError(431, f"the head has more than {MAX_HEAD_BYTES} bytes")
                self._searched = max(0, len(buffer) - len(HEAD_END) + 1)
                return None
            self._searched = 0
            request = self._parser.parse(bytes(buffer[:end]))
            del buffer[: end + len(HEAD_END)]
            if request.waits_to_send and not buffer:
                self._outlet.write(b"HTTP/1.1 100 Continue\r\n\r\n")
        if len(buffer) < request.body_bytes:
            self._awaited = request
            return None
        self._awaited = None
        if request.body_bytes:
            request = replace(request, body=bytes(buffer[: request.body_bytes]))
            del buffer[: request.body_bytes]
        return request

    # Answering.

    def _answer(self, request: Request) -> None:
        self._begun = self._fresh = False
        self._keep_alive = request.keep_alive and not self._site.stopping
        self._exchange = exchange = Exchange(self.address, self._loop.time(), request)
        answer = self._site.answer(exchange)
        if isinstance(answer, Response):
            self._send(answer)
        else:
            exchange.waited = True
            self._task = self._loop.create_task(self._answer_later(exchange, answer))

    async def _answer_later(
        self, exchange: Exchange, answer: StreamedResponse | Coroutine[Any, Any, AnyResponse]
    ) -> None:
        try:
            response = answer if isinstance(answer, StreamedResponse) else await answer
            if isinstance(response, StreamedResponse):
                await self._stream(exchange, response)
            else:
                self._task = None
                self._send(response)
        except asyncio.CancelledError:
            if not self.cut:
                raise

    async def _stream(self, exchange: Exchange, response: StreamedResponse) -> None:
        request = exchange.request
        assert request is not None
        fields = fields_text(response.fields)
        if request.chunks:
            fields += b"Transfer-Encoding: chunked\r\n"
        else:
            self._keep_alive = False
        exchange.status, exchange.first_s = response.status, self._loop.time()
        head = self._head(response.status, fields, request.chunks)
        self._writer = writer = _Writer(self, exchange, head, request.chunks)
        try:
            await response.produce(writer)
            await writer.end()
        except asyncio.CancelledError:
            raise
        except Exception as error:
            self._site.failed(exchange, error)
            exchange.status = CLIENT_GONE
            self._transport.abort()
            return
        finally:
            self._writer = None
            exchange.facts = response.facts()
            if self.cut:
                self._finish_exchange(CLIENT_GONE)
        self._outlet.hold_at_most(0)
        self._task = None
        self._finish_response()

    def _send(self, response: Response) -> None:
        exchange = self._exchange
        assert exchange is not None
        request, body = exchange.request, response.body
        status = exchange.status = response.status
        fields = response.fields_text or whole_fields(response)
        if request is not None and request.method == "HEAD":
            body = b""
        exchange.first_s = self._loop.time()
        exchange.body_bytes = len(body)
        head = self._head(status, fields, request is None or request.chunks)
        self._outlet.send(head, body, self._finish_response)

    def _head(self, status: int, fields: bytes, modern: bool) -> bytes:
        keep_alive = self._keep_alive and (not self._ended or bool(self._buffer))
        return self._site.heads.head(status, fields, keep_alive, modern, time.time())

    def _finish_response(self) -> None:
        """The response is on its way: on to the next request, if there is to be one."""
        self._finish_exchange()
        if self._transport.is_closing():
            return
        now_s = self._loop.time()
        if not self._keep_alive or (self._ended and not self._buffer):
            self._linger(now_s)
            return
        self._deadline_s = now_s + self._site.patience.keepalive_timeout_s
        if not self._reading and len(self._buffer) <= READ_AHEAD_BYTES:
            self._reading = True
            self._transport.resume_reading()
        if self._buffer and not self._due:
            # Not at once, or as many responses would be on the stack as requests came together.
            self._due = True
            self._loop.call_soon(self._read_requests)

    def _finish_exchange(self, status: int = 0) -> None:
        exchange, self._exchange = self._exchange, None
        if exchange is not None:
            exchange.status = status or exchange.status
            self._site.finished(exchange, self._loop.time())

    def _linger(self, now_s: float) -> None:
        """Ends the connection; reads on for a while, or what still comes would make the kernel
        drop the response."""
        if self._ended or not self._outlet.end():
            self._close()
            return
        self._lingers, self._deadline_s = True, now_s + LINGER_S
        self._buffer.clear()
        if not self._reading:
            self._reading = True
            self._transport.resume_reading()

    def _close(self) -> None:
        self._outlet.close(self._site.patience.write_timeout_s)

    # Time.

    def check(self, now_s: float) -> None:
        """Ends the connection if its client takes too long. To be called twice a second or so."""
        patience = self._site.patience
        least_bytes = patience.least_rate_bytes * patience.write_timeout_s
        if self._outlet.has_stalled(now_s, patience.write_timeout_s, max(1.0, least_bytes)):
            self._end("stalled", "write")
        elif self._exchange is not None or now_s < self._deadline_s or self._transport.is_closing():
            return
        elif self._lingers:
            self._transport.abort()
        elif self._begun:
            self._site.cut("head")
            self._keep_alive = False
            self._exchange = exchange = Exchange(self.address, now_s)
            self._buffer.clear()
            message = "the request was not complete in time"
            exchange.note = message
            self._send(error_response(HTTPStatus.REQUEST_TIMEOUT, message, {}))
        else:
            self._site.cut("idle")
            self._close()

    def _request_deadline_s(self) -> float:
        """When a request must have come of which the first byte comes now."""
        patience_s = self._site.patience.request_timeout_s
        return self._loop.time() + (
            min(patience_s, LAST_CALL_S) if self._site.stopping else patience_s
        )

    def stop(self) -> None:
        """Closes the connection as soon as no response is on its way. Whose request is, as the
        connection was accepted a moment ago, is answered yet."""
        self._keep_alive = False
        if self._exchange is not None or self._lingers:
            return
        if self._fresh or self._begun:
            self._deadline_s = min(self._deadline_s, self._request_deadline_s())
        else:
            self._close()

    def abort(self, why: str = "stopped") -> None:
        """Ends the connection now."""
        self.cut = self.cut or why
        self._transport.abort()

    def _end(self, why: str, kind: str) -> None:
        self._site.cut(kind)
        self.abort(why)


class _Writer:
    """The body of a streamed response; see BodyWriter."""

    def __init__(
        self, connection: HttpConnection, exchange: Exchange, head: bytes, chunks: bool
    ) -> None:
        self._connection = connection
        self._outlet = connection._outlet
        self._exchange = exchange
        self._head = head
        self._chunks = chunks
        self._room: asyncio.Future[None] | None = None
        self._turn_bytes = 0  # written since the other connections had their turn

    @property
    def cut(self) -> str:
        return self._connection.cut

    def hold_at_most(self, queue_bytes: int) -> None:
        self._outlet.hold_at_most(queue_bytes)

    def queued_bytes(self) -> int:
        return self._outlet.queued_bytes()

    def tcp_info(self) -> TcpInfo | None:
        return self._outlet.tcp_info()

    async def write(self, data: bytes) -> None:
        self._exchange.body_bytes += len(data)
        self._turn_bytes += len(data)
        parts = (b"%x\r\n" % len(data), data, b"\r\n") if self._chunks else (data,)
        if data:  # a chunk of no bytes would be the end
            self._outlet.write(b"".join((self._head, *parts)))
            self._head = b""
        await self._has_room()

    async def end(self) -> None:
        self._outlet.write(self._head + (b"0\r\n\r\n" if self._chunks else b""))
        await self._has_room()

    async def _has_room(self) -> None:
        if self._turn_bytes >= PIECE_BYTES:
            self._turn_bytes = 0
            await asyncio.sleep(0)
        while self._outlet.paused:
            self._room = asyncio.get_running_loop().create_future()
            await self._room

    def resume(self) -> None:
        if self._room is not None and not self._room.done():
            self._room.set_result(None)
