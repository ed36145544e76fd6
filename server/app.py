"""The HTTP application: a request in, a response out, whatever happens in between.

Rule: nothing that a client does shows up as a traceback, and where files lie is nobody's business
but the operator's.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Coroutine
from typing import Any

from codec.errors import SwingsError
from server.abr.standing import MAX_BODY_BYTES, PLAY_HEADER, RATE_HEADER

from .answers.call import Call
from .http.errors import RequestError
from .http.response import AnyResponse, HeadWriter, Response, error_response
from .http.site import Connection, Exchange, Site
from .router import OBJECT_ROUTE, find_route
from .state.serverstate import ServerState

log = logging.getLogger(__name__)

PREFLIGHT_AGE_S = 86400
"""Seconds that a browser may remember what a preflight said."""

ALLOWED_HEADERS = f"Range, If-Range, If-None-Match, Content-Type, {PLAY_HEADER}, {RATE_HEADER}"
"""What a page of another origin may send."""


class Application(Site):
    """Answers the requests of all connections of one event loop."""

    def __init__(self, state: ServerState) -> None:
        self.state = state
        self.patience = state.config.patience
        self.max_body_bytes = MAX_BODY_BYTES
        self.heads = HeadWriter(_common_fields(state.config.cors_origin))
        self.connections: set[Connection] = set()
        self.emptied = asyncio.Event()

    @property
    def stopping(self) -> bool:
        return self.state.stopping.is_set()

    def answer(self, exchange: Exchange) -> AnyResponse | Coroutine[Any, Any, AnyResponse]:
        request = exchange.request
        assert request is not None
        if request.is_plain:
            # Of all requests the most by far, and always the same.
            ready = self.state.cache.response(request.path)
            if ready is not None:
                exchange.route = OBJECT_ROUTE
                return ready
        if request.method == "OPTIONS":
            return _preflight()
        try:
            route, names = find_route(request.method, request.path)
            exchange.route = route.template
            answer = route.handler(Call(self.state, request, exchange.address, names))
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
        self._log(exchange, error)
        if isinstance(error, SwingsError | OSError):
            return error_response(500, "this stream is damaged on the server", {})
        return error_response(500, "the server has a bug; its log says more", {})

    def _log(self, exchange: Exchange, error: Exception) -> None:
        path = exchange.request.path if exchange.request is not None else ""
        if isinstance(error, SwingsError | OSError):
            log.error("%s: %s", path, error)
        else:
            log.error("%s failed", path, exc_info=error)

    def failed(self, exchange: Exchange, error: Exception) -> None:
        self._log(exchange, error)

    def finished(self, exchange: Exchange, now_s: float) -> None:
        self.state.metrics.requests.add(1, exchange.route, str(exchange.status))

    def cut(self, kind: str) -> None:
        self.state.metrics.timeouts.add(1, kind)

    def has_room(self) -> bool:
        return len(self.connections) < self.state.config.max_connections

    def paused(self) -> None:
        self.state.metrics.accept_pauses.add(1)

    def admit(self, address: str) -> bytes | None:
        return None

    def closed(self, address: str) -> None:
        pass


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
