"""Helpers of all handlers: the stream that a URL names, and room for a play."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from contextlib import contextmanager

from aiohttp import web

from server.http.errors import RequestError
from server.http.requestlog import WAITS_FROM_S, address_of
from server.library import ServedStream
from server.state.serverstate import STATE

RETRY_AFTER_S = 5
"""Seconds after which a refused client may ask again."""

STREAM = "/v1/streams/{stream}"
"""How the routes of a stream begin."""


def stream_of(request: web.Request) -> ServedStream:
    """The stream that the URL names. Raises RequestError 404 where there is none."""
    name = request.match_info["stream"]
    stream = request.app[STATE].library.streams.get(name)
    if stream is None:
        raise RequestError(404, f"no stream is named {name[:80]!a}; /v1/streams lists all")
    return stream


def parse_number(key: str, text: str, most: int) -> int:
    """A number of a query. Raises RequestError 400 for what is none from 0 to `most`."""
    if not (text.isascii() and text.isdigit() and len(text) <= 10 and int(text) <= most):
        raise RequestError(400, f"{key}={text[:40]!a} is not a number from 0 to {most}")
    return int(text)


def waits(request: web.Request) -> None:
    """Has the time from now to the first byte of the response be measured."""
    request[WAITS_FROM_S] = asyncio.get_running_loop().time()


@contextmanager
def room_for_play(request: web.Request, continues: bool = False) -> Iterator[None]:
    """Holds a play's place for the client. Raises RequestError 503 if there may not be one more
    play, 429 if this client may not have one more. continues: see `Overload.accepts_plays`."""
    state = request.app[STATE]
    if state.stopping.is_set():
        raise RequestError(503, "the server is stopping", {"Retry-After": str(RETRY_AFTER_S)})
    if not state.overload.accepts_plays(len(state.plays), continues):
        state.metrics.refused.add(1, "play_load")
        message = f"the server is full, with {len(state.plays)} plays; try again later"
        after_s = max(RETRY_AFTER_S, state.overload.retry_after_s)
        raise RequestError(503, message, {"Retry-After": str(after_s)})
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
