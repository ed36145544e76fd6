"""Helpers of all handlers: the stream that a URL names, the client, and room for a play."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from contextlib import contextmanager
from urllib.parse import parse_qsl

from aiohttp import web

from server.http.errors import RequestError
from server.http.requestlog import WAITS_FROM_S, address_of
from server.library import ServedStream
from server.state.serverstate import STATE, ServerState

RETRY_AFTER_S = 5
"""Seconds after which a refused client may ask again."""

STREAM = "/v1/streams/{stream}"
"""How the routes of a stream begin."""

_OF_PROXIES = ("X-Forwarded-For", "Forwarded", "Via")
"""Fields that proxies add to a request."""


def stream_of(request: web.Request) -> ServedStream:
    """The stream that the URL names. Raises RequestError 404 where there is none."""
    name = request.match_info["stream"]
    stream = request.app[STATE].library.streams.get(name)
    if stream is None:
        raise RequestError(404, f"no stream is named {name[:80]!a}; /v1/streams lists all")
    return stream


def query_of(request: web.Request) -> list[tuple[str, str]]:
    """The pairs of the query."""
    return parse_qsl(request.rel_url.raw_query_string, keep_blank_values=True)


def is_proxied(request: web.Request) -> bool:
    """Whether something between the client and this server takes in what is sent to it."""
    return any(name in request.headers for name in _OF_PROXIES)


def waits(request: web.Request) -> None:
    """Has the time from now to the first byte of the response be measured."""
    request[WAITS_FROM_S] = asyncio.get_running_loop().time()


def check_room(state: ServerState, continues: bool = False) -> None:
    """Raises RequestError 503 unless one more play may begin. continues: see
    `Overload.accepts_plays`."""
    if state.stopping.is_set():
        raise RequestError(503, "the server is stopping", {"Retry-After": str(RETRY_AFTER_S)})
    if not state.overload.accepts_plays(len(state.plays), continues):
        state.metrics.refused.add(1, "play_load")
        message = f"the server is full, with {len(state.plays)} plays; try again later"
        after_s = max(RETRY_AFTER_S, state.overload.retry_after_s)
        raise RequestError(503, message, {"Retry-After": str(after_s)})


@contextmanager
def place_of(request: web.Request) -> Iterator[None]:
    """Holds a play's place for the client. Raises RequestError 429."""
    state = request.app[STATE]
    address = address_of(request, state.proxies)
    refusal = state.play_admission.admit(address)
    if refusal is not None:
        state.metrics.refused.add(1, f"play_{refusal}")
        message = "too many plays from this address; try again later"
        raise RequestError(429, message, {"Retry-After": str(RETRY_AFTER_S)})
    try:
        yield
    finally:
        state.play_admission.release(address)
