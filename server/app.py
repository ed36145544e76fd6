"""The HTTP application: a request in, a response out, whatever happens in between.

Rule: nothing that a client does shows up as a traceback, and where files lie is nobody's business
but the operator's.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Coroutine
from typing import Any

from codec.errors import SwingsError
from server.abr.standing import FRAME_HEADER, MAX_BODY_BYTES, PLAY_HEADER, RATE_HEADER

from .answers.call import Call
from .http.errors import RequestError
from .http.response import AnyResponse, HeadWriter, Response, error_response
from .http.site import Connection, Exchange, Site
from .operate.admission import Admission
from .operate.clientaddress import client_address, is_proxy
from .operate.descriptors import connection_limit
from .operate.log.eventlog import EventLog
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
"""What a page of another origin may send."""


class Application(Site):
    """Answers the requests of all connections of one event loop."""

    def __init__(self, state: ServerState, log: EventLog | None = None) -> None:
        """log: where each request gets a line; None for nowhere."""
        config, admission = state.config, state.config.admission
        self.state = state
        self.patience = config.patience
        self.max_body_bytes = MAX_BODY_BYTES
        self.heads = HeadWriter(_common_fields(config.cors_origin))
        self.connections: set[Connection] = set()
        self.emptied = asyncio.Event()
        self._max_connections = connection_limit(admission.max_connections)
        self._admission = Admission(
            self._max_connections, admission.max_address_connections, state.proxies
        )
        self._log = log if config.log_requests else None

    @property
    def stopping(self) -> bool:
        return self.state.stopping.is_set()

    def answer(self, exchange: Exchange) -> AnyResponse | Coroutine[Any, Any, AnyResponse]:
        request, state = exchange.request, self.state
        assert request is not None
        if request.method == "OPTIONS":
            return _preflight()
        try:
            if state.signer is not None:
                request.path = _granted_path(request.path, state.signer)
            if request.is_plain:
                # Of all requests the most by far, and always the same.
                ready = state.cache.response(request.path)
                if ready is not None:
                    exchange.route = OBJECT_ROUTE
                    return ready
            route, names = find_route(request.method, request.path)
            exchange.route = route.template
            behind_proxy = is_proxy(exchange.address, state.proxies)
            if behind_proxy and request.forwarded:
                forwarded = (request.forwarded,)
                exchange.address = client_address(exchange.address, forwarded, state.proxies)
            answer = route.handler(Call(state, request, exchange.address, behind_proxy, names))
        except Exception as error:
            return self._refusal(exchange, error)
        return self._guarded(exchange, answer) if asyncio.iscoroutine(answer) else answer

    async def _guarded(
        self, exchange: Exchange, answer: Coroutine[Any, Any, AnyResponse]
    ) -> AnyResponse:
        try:
            return await answer
        except Exception as error:
            return self._refusal(exchange, error)

    def _refusal(self, exchange: Exchange, error: Exception) -> Response:
        """The response that says `error`."""
        if isinstance(error, RequestError):
            exchange.note = str(error)
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

    def failed(self, exchange: Exchange, error: Exception) -> None:
        self._report(exchange, error)

    def finished(self, exchange: Exchange, now_s: float) -> None:
        state, began_s = self.state, exchange.began_s
        state.metrics.requests.add(1, exchange.route, str(exchange.status))
        if exchange.waited:
            state.metrics.ttfb.observe(exchange.first_s - began_s)
        if self._log is not None:
            self._write_line(self._log, exchange, round(1e3 * (now_s - began_s), 1))

    def _write_line(self, log: EventLog, exchange: Exchange, took_ms: float) -> None:
        request = exchange.request
        numbers = {"status": exchange.status, "bytes": exchange.body_bytes, "ms": took_ms}
        note = without_signatures(exchange.note) or None
        if request is None:
            log.event("request", address=exchange.address, **numbers, note=note)
            return
        path = request.path
        if exchange.status >= 400 or path.startswith("/t/"):
            path = without_signatures(path)
        texts = (("address", exchange.address), ("method", request.method), ("path", path))
        if request.is_plain and note is None and not exchange.facts:
            log.often("request", texts, numbers)
            return
        query = without_signatures(request.query) or None
        fields = {**dict(texts), "query": query, **numbers, "note": note, **exchange.facts}
        log.event("request", **fields)

    def sent(self, num_bytes: int) -> None:
        # At once: a play that runs for an hour is load all the time.
        self.state.sent_bytes += num_bytes

    def cut(self, kind: str) -> None:
        self.state.metrics.timeouts.add(1, kind)

    def has_room(self) -> bool:
        # Those too that were accepted just now, or are still at their handshake.
        return self._admission.num_held < self._max_connections

    def paused(self) -> None:
        self.state.metrics.accept_pauses.add(1)

    def admit(self, address: str) -> bytes | None:
        refusal = self._admission.admit(address)
        if refusal is None:
            return None
        self.state.metrics.refused.add(1, f"connection_{refusal}")
        return _TOO_MANY

    def closed(self, address: str) -> None:
        self._admission.release(address)


_TOO_MANY = (
    b"HTTP/1.1 429 Too Many Requests\r\nRetry-After: 5\r\nContent-Length: 0\r\n"
    b"Connection: close\r\n\r\n"
)
"""For an address that has all the connections that one may have."""


def _granted_path(path: str, signer: Signer) -> str:
    """The path without its signature. Raises RequestError 403 for one that needs another."""
    if path.startswith("/t/"):
        grant = signer.verify(path, time.time())
        if isinstance(grant, Grant):
            return grant.path
        raise RequestError(403, f"access denied: {_REASONS[grant]}")
    if needs_signature(path):
        raise RequestError(403, f"access denied: {_REASONS[Reason.UNSIGNED]}")
    return path


_REASONS = {
    Reason.UNSIGNED: "the URL is not signed",
    Reason.KEY: "the key of the URL is not valid on this server",
    Reason.SIGNATURE: "the signature does not match the URL",
    Reason.EXPIRED: "the URL has expired",
}


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
    """What every response says: who may read it from a page of another origin."""
    fields = {"X-Content-Type-Options": "nosniff"}
    if cors_origin:
        exposed = f"ETag, Content-Range, Accept-Ranges, Retry-After, {PLAY_HEADER}, {RATE_HEADER}"
        fields |= {
            "Access-Control-Allow-Origin": cors_origin,
            "Access-Control-Expose-Headers": exposed,
            "Cross-Origin-Resource-Policy": "cross-origin",
            "Timing-Allow-Origin": cors_origin,
        }
    return fields
