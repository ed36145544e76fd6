"""The HTTP application: a request in, a response out, whatever happens in between.

Rule: no request causes a traceback, and only the operator's log names paths of files.
"""

from __future__ import annotations

import asyncio
import logging
import math
import time
from collections.abc import Coroutine
from typing import Any

from aiohttp import HttpVersion11, web

from codec.errors import SwingsError
from server.abr.clientstatus import (
    FRAME_HEADER,
    LIVE_HEADER,
    MAX_BODY_BYTES,
    NUM_FRAMES_HEADER,
    PLAY_HEADER,
    RATE_HEADER,
    RECEIVED_HEADER,
    REPORT_HEADER,
)

from .answers.call import Answer, Call
from .answers.pages import busy_page, refused_page
from .clients.connection import ClientConnection, Clients, connection_of
from .clients.http import http_server
from .clients.reply import CLOSED, KEPT, StreamedBody, send
from .exchange.content import private_caching
from .exchange.errors import RequestError
from .exchange.exchange import CLIENT_GONE, Exchange
from .exchange.request import Request, body_bytes, read_request
from .exchange.response import (
    AnyResponse,
    HeadWriter,
    Response,
    StreamedResponse,
    error_response,
)
from .operate.clientaddress import client_address, is_proxy
from .operate.log.eventlog import EventLog
from .operate.log.logline import LogRequests, Value
from .operate.sign.signing import (
    Grant,
    Reason,
    Signer,
    needs_signature,
    without_signatures,
)
from .router import OBJECT_ROUTE, find_route
from .state.serverstate import ServerState

log = logging.getLogger(__name__)

PREFLIGHT_AGE_S = 86400
"""Seconds that a browser may remember what a preflight said."""

ALLOWED_HEADERS = (
    f"Range, If-Range, If-None-Match, Content-Type, {PLAY_HEADER}, {RATE_HEADER}, {FRAME_HEADER}"
)
"""Request headers that a page of another origin may send."""


class Application:
    """Answers the requests of all connections of one event loop."""

    def __init__(self, state: ServerState, log: EventLog | None = None) -> None:
        """log: where each request gets a line; None for nowhere."""
        config = state.config
        self.state = state
        self._request_timeout_s = config.timeouts.request_timeout_s
        self._common = _common_fields(config.cors_origin)
        self._heads = HeadWriter(self._common)
        self._log = log
        self._logs_all = config.log_requests is LogRequests.ALL
        self._clock = asyncio.get_running_loop().time
        http = http_server(
            self.handle, self.refused, config.timeouts.keepalive_timeout_s, self._common
        )
        self.clients = Clients(http, self.refused, config.timeouts, state.metrics)
        """The shared state of this application's connections."""

    async def handle(self, asked: web.BaseRequest) -> web.StreamResponse:
        """Answers one request of a ClientConnection, to the end."""
        connection = connection_of(asked)
        exchange = Exchange(connection.address, self._clock(), asked.method)
        closing, sent_s = True, 0.0
        try:
            response = await self._respond(asked, connection, exchange)
            exchange.first_s = self._clock()
            exchange.closes |= self.state.stopping.is_set() or not asked.keep_alive
            if isinstance(response, StreamedResponse):
                sent = await self._stream(asked, connection, exchange, response)
            else:
                sent = await self._send(asked, connection, exchange, response)
            closing = not sent.keep_alive
            sent_s = self._clock()
            await connection.deliver(closing)
        except asyncio.CancelledError:
            sent_s, exchange.status = 0.0, CLIENT_GONE
            raise
        finally:
            sent_bytes = connection.take_sent_bytes()
            self._count(sent_bytes)
            if exchange.status == CLIENT_GONE and connection.cut:
                exchange.body_bytes = min(exchange.body_bytes, sent_bytes)
                exchange.facts = {**exchange.facts, "outcome": connection.cut}
            connection.end(closing)
            self.finished(exchange, sent_s or self._clock())
        return sent

    async def _send(
        self,
        asked: web.BaseRequest,
        connection: ClientConnection,
        exchange: Exchange,
        response: Response,
    ) -> web.StreamResponse:
        exchange.status, body = response.status, response.body
        stays = not exchange.closes
        if asked.method == "HEAD":
            body = b""
        exchange.body_bytes = len(body)
        modern = asked.version >= HttpVersion11
        text = response.head_fields()
        head = self._heads.head(response.status, text, stays, modern, time.time())
        try:
            await send(asked, connection, head, body)
        except ConnectionError:
            exchange.status = CLIENT_GONE
        return KEPT if stays else CLOSED

    async def _stream(
        self,
        asked: web.BaseRequest,
        connection: ClientConnection,
        exchange: Exchange,
        response: StreamedResponse,
    ) -> web.StreamResponse:
        """Sends a body that is made meanwhile. Nothing may wait before it is begun: its end gives
        back what it holds."""
        exchange.status, exchange.waited, connection.needs_client = 200, True, True
        exchange.is_streamed = True
        body = StreamedBody(asked, response, connection, self._common, self._count)
        if (
            exchange.closes or asked.version < HttpVersion11
        ):  # only the end of the connection ends it then
            body.response.force_close()
        try:
            await response.produce(body)
            await body.end()
        except ConnectionError:
            exchange.status = CLIENT_GONE
        except Exception as error:
            self._report(exchange, error)
            exchange.status = CLIENT_GONE
            connection.abort()
        finally:
            connection.needs_client = False
            exchange.body_bytes, exchange.facts = body.num_bytes, response.facts()
        return body.response

    async def _respond(
        self, asked: web.BaseRequest, connection: ClientConnection, exchange: Exchange
    ) -> AnyResponse:
        """The response to a request; never raises but for CancelledError."""
        try:
            if asked.version.major != 1:
                raise RequestError(505, "this server supports only HTTP/1.1 and HTTP/1.0")
            request = read_request(asked.method, asked.raw_path, asked.headers)
            exchange.request = request
            num_bytes = body_bytes(request, MAX_BODY_BYTES)
            if num_bytes:
                request.body = await self._body(asked, connection, num_bytes)
        except Exception as error:
            exchange.closes = True
            return self._refusal(exchange, error)
        answer = self.answer(exchange, request)
        if not asyncio.iscoroutine(answer):
            return answer
        exchange.waited = True
        return await answer

    async def _body(
        self, asked: web.BaseRequest, connection: ClientConnection, num_bytes: int
    ) -> bytes:
        if "Expect" in asked.headers and asked.version >= HttpVersion11:
            connection.transport.write(b"HTTP/1.1 100 Continue\r\n\r\n")
        connection.needs_client = True
        if connection.is_half_closed and not asked.content.is_eof():
            connection.abort("gone")  # the rest of the body will not come
        try:
            async with asyncio.timeout(self._request_timeout_s):
                return await asked.content.readexactly(num_bytes)
        except TimeoutError as error:
            self.state.metrics.timeouts.add(1, "head")
            raise RequestError(408, "the request was not complete in time") from error
        finally:
            connection.needs_client = False

    def answer(
        self, exchange: Exchange, request: Request
    ) -> AnyResponse | Coroutine[Any, Any, AnyResponse]:
        """The response to a request that is whole."""
        state = self.state
        if request.method == "OPTIONS":
            return _preflight()
        expiry_s: int | None = None
        try:
            if state.signer is not None:
                request.path, expiry_s = _granted_path(request.path, state.signer)
            answer = self._answer(exchange, request)
        except Exception as error:
            return self._refusal(exchange, error)
        if asyncio.iscoroutine(answer):
            return self._guarded(exchange, answer, expiry_s)
        return _cached_privately(answer, expiry_s)

    def _answer(self, exchange: Exchange, request: Request) -> Answer:
        """The answer to a request that needs no more permission."""
        state = self.state
        if request.is_plain:
            # Of all requests the most by far, and always the same.
            ready = state.cache.response(request.path)
            if ready is not None:
                exchange.route = OBJECT_ROUTE
                return ready
        route, names = find_route(request.method, request.path)
        exchange.route = route.template
        behind_proxy = is_proxy(exchange.address, state.proxies)
        if behind_proxy and "X-Forwarded-For" in request.fields:
            forwarded = request.fields.getall("X-Forwarded-For")
            exchange.address = client_address(exchange.address, forwarded, state.proxies)
        return route.handler(Call(state, request, exchange.address, behind_proxy, names))

    async def _guarded(
        self,
        exchange: Exchange,
        answer: Coroutine[Any, Any, AnyResponse],
        expiry_s: int | None,
    ) -> AnyResponse:
        try:
            return _cached_privately(await answer, expiry_s)
        except Exception as error:
            return self._refusal(exchange, error)

    def _refusal(self, exchange: Exchange, error: Exception) -> Response:
        """The response that says `error`."""
        if isinstance(error, RequestError):
            exchange.note = str(error)
            if _is_for_a_person(exchange.request):
                if isinstance(error, AccessError):
                    return refused_page(error.has_expired)
                if error.status in (429, 503):
                    return busy_page(error)
            return error_response(error.status, str(error), error.headers)
        self._report(exchange, error)
        if isinstance(error, SwingsError | OSError):
            return error_response(500, "this stream is damaged on the server", {})
        return error_response(500, "internal server error; see the server's log", {})

    def _report(self, exchange: Exchange, error: Exception) -> None:
        path = ""
        if exchange.request is not None:
            path = without_signatures(exchange.request.path)[:200]
        if isinstance(error, SwingsError | OSError):
            log.error("%s: %s", path, error)
        else:
            log.error("%s failed", path, exc_info=error)

    def _count(self, sent_bytes: int) -> None:
        self.state.sent_bytes += sent_bytes

    def refused(self, address: str, status: int, note: str) -> None:
        """Logs a request that was answered below this application: not HTTP, or incomplete."""
        exchange = Exchange(address, self._clock(), status=status, note=note)
        self.finished(exchange, exchange.began_s)

    def finished(self, exchange: Exchange, now_s: float) -> None:
        state, began_s = self.state, exchange.began_s
        state.metrics.requests.add(1, exchange.route, str(exchange.status))
        if exchange.waited and exchange.first_s:
            state.metrics.ttfb.observe(exchange.first_s - began_s)
        if self._log is not None and (self._logs_all or exchange.is_told):
            self._write_line(self._log, exchange, round(1e3 * (now_s - began_s), 1))

    def _write_line(self, log: EventLog, exchange: Exchange, took_ms: float) -> None:
        request, note = exchange.request, exchange.note
        fields: dict[str, Value] = {"address": exchange.address, "method": exchange.method or None}
        if request is not None:
            path, query = request.path, request.query
            # The path of a granted request has lost its signature; a preflight is answered before.
            if exchange.status >= 400 or request.method == "OPTIONS" or path.startswith("/t/"):
                path = without_signatures(path)
            fields["path"] = path
            fields["query"] = without_signatures(query) if query else None
        fields["status"], fields["bytes"] = exchange.status, exchange.body_bytes
        fields["ms"] = took_ms
        fields["note"] = without_signatures(note) if note else None
        fields.update(exchange.facts)
        log.event("request", **fields)


class AccessError(RequestError):
    """The path of a request is not signed, or not any more."""

    def __init__(self, reason: Reason) -> None:
        super().__init__(403, f"access denied: {reason}")
        self.has_expired = reason is Reason.EXPIRED


def _is_for_a_person(request: Request | None) -> bool:
    """Whether a browser shows the answer; programs ask for no HTML."""
    return request is not None and "text/html" in request.fields.get("Accept", "")


def _granted_path(path: str, signer: Signer) -> tuple[str, int | None]:
    """The path without its signature, and when that expires, in Unix seconds; None for a path that
    has none. Raises AccessError for one that needs another."""
    if path.startswith("/t/"):
        grant = signer.verify(path, time.time())
        if isinstance(grant, Grant):
            return grant.path, grant.expiry_s
        raise AccessError(grant)
    if needs_signature(path):
        raise AccessError(Reason.UNSIGNED)
    return path, None


def _cached_privately(response: AnyResponse, expiry_s: int | None) -> AnyResponse:
    """`response` as the answer to a URL whose signature expires at `expiry_s`, if it has one."""
    # Nothing keeps a play, signed or not.
    if expiry_s is None or isinstance(response, StreamedResponse):
        return response
    left_s = expiry_s - math.ceil(time.time())
    cache_control = private_caching(response.fields.get("Cache-Control", ""), left_s)
    fields = {**response.fields, "Cache-Control": cache_control}
    return Response(response.status, fields, response.body, response.length)


def _preflight() -> Response:
    return Response(
        204,
        {
            "Access-Control-Allow-Methods": "GET, HEAD, POST",
            "Access-Control-Allow-Headers": ALLOWED_HEADERS,
            "Access-Control-Max-Age": str(PREFLIGHT_AGE_S),
        },
    )


def _common_fields(cors_origin: str) -> dict[str, str]:
    """The fields of every response, with the origin whose pages may read it."""
    # Without the second field, aiohttp names itself and the version of Python.
    fields = {"X-Content-Type-Options": "nosniff", "Server": "swings"}
    if cors_origin:
        exposed = ", ".join(
            (
                "ETag",
                "Content-Range",
                "Accept-Ranges",
                "Retry-After",
                PLAY_HEADER,
                RATE_HEADER,
                REPORT_HEADER,
                RECEIVED_HEADER,
                NUM_FRAMES_HEADER,
                LIVE_HEADER,
            )
        )
        fields |= {
            "Access-Control-Allow-Origin": cors_origin,
            "Access-Control-Expose-Headers": exposed,
            "Cross-Origin-Resource-Policy": "cross-origin",
            "Timing-Allow-Origin": cors_origin,
        }
    return fields
