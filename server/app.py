"""The application: its routes, what surrounds them, and what lives as long as it.

Rule: no request causes a traceback, and only the operator's log names paths of files.
"""

from __future__ import annotations

import asyncio
import logging
import math
import time
from collections.abc import AsyncIterator, Coroutine, Mapping
from contextlib import asynccontextmanager
from functools import partial
from typing import Any

from aiohttp import web
from aiohttp.typedefs import Handler

from codec.errors import SwingsError
from server.abr.clientstatus import (
    FRAME_HEADER,
    LIVE_HEADER,
    MAX_BODY_BYTES,
    NUM_FRAMES_HEADER,
    PLAY_HEADER,
    RATE_HEADER,
    REPORT_HEADER,
)
from server.operate.overload import LoadSample, measure_lag, measure_load

from .answers import objects, pages, play, statusreport
from .answers import objects as download
from .http.connection import Connection, connection_of
from .http.content import private_caching
from .http.errors import RequestError
from .http.requestlog import CLIENT_GONE, FACTS, GRANT, NOTE, SENT_BYTES, SIGNED, WAITS_FROM_S
from .listener import BACKLOG
from .operate.log import EventLog
from .operate.sign.signing import Grant, Reason, needs_signature, without_signatures
from .state.serverstate import STATE, ServerState

log = logging.getLogger(__name__)

ROUTES: list[web.AbstractRouteDef] = [
    *objects.routes,
    *play.routes,
    *statusreport.routes,
    *download.routes,
    *pages.routes,
    *objects.last_routes,
]
"""All routes of the server, the most used first."""

PREFLIGHT = {
    "Access-Control-Allow-Methods": "GET, HEAD, POST",
    "Access-Control-Allow-Headers": (
        "Range, If-Range, If-None-Match, Content-Type, "
        f"{PLAY_HEADER}, {RATE_HEADER}, {FRAME_HEADER}"
    ),
    "Access-Control-Max-Age": "86400",
}
"""What pages of other origins may ask, and for how many seconds a browser may remember that."""

EXPOSED = (
    "ETag",
    "Content-Range",
    "Accept-Ranges",
    "Retry-After",
    PLAY_HEADER,
    RATE_HEADER,
    REPORT_HEADER,
    NUM_FRAMES_HEADER,
    LIVE_HEADER,
)
"""Headers of responses that pages of other origins may read."""

WORKERS_STOP_S = 0.5
"""Seconds for what other workers still ask when this one has ended."""


class AccessError(RequestError):
    """The path of a request is not signed, or not any more."""

    def __init__(self, reason: Reason) -> None:
        super().__init__(403, f"access denied: {reason}")
        self.has_expired = reason is Reason.EXPIRED


def create_app(state: ServerState, log: EventLog | None = None) -> web.Application:
    """The application of one worker. log: whose dropped lines are counted."""
    app = web.Application(middlewares=(errors, signed), client_max_size=MAX_BODY_BYTES)
    app[STATE] = state
    app.add_routes(ROUTES)
    if state.signer is not None:
        app.add_routes(map(signed_route, ROUTES))
    app.on_response_prepare.append(partial(complete, common_headers(state.config.cors_origin)))
    app.on_shutdown.append(end_plays)
    app.cleanup_ctx.extend((follow_library, answer_workers, partial(measure, log=log)))
    return app


def signed_route(route: web.AbstractRouteDef) -> web.RouteDef:
    """The same below a signature."""
    if not isinstance(route, web.RouteDef):
        raise TypeError(f"{route!r} is a folder of files, which URLs with signatures cannot have")
    return web.RouteDef(route.method, SIGNED + route.path, route.handler, route.kwargs)


@web.middleware
async def errors(request: web.Request, handler: Handler) -> web.StreamResponse:
    """Answers every error with one line of JSON, or a person with a page; and preflights."""
    try:
        if request.version.major != 1:
            # aiohttp would answer in the version that was asked for.
            connection_of(request).refuse(505)
            raise RequestError(505, "this server supports only HTTP/1.1 and HTTP/1.0")
        if request.method == "OPTIONS":
            return web.Response(status=204, headers=PREFLIGHT)
        return await handler(request)
    except (ConnectionError, asyncio.CancelledError):
        # Cancelled are those whose client did not take them before the server had to end.
        await asyncio.sleep(0)  # for the connection, which is told why it is lost
        return gone(request)
    except web.HTTPException as raised:
        if raised.status < 400:  # a redirection
            raise
        error = refusal_of(raised)
        request[NOTE] = str(error)
        if "text/html" in request.headers.get("Accept", ""):  # programs ask for no HTML
            if isinstance(error, AccessError):
                return pages.refused_page(error.has_expired)
            if error.status in (429, 503):
                return pages.busy_page(error)
        raise error from None
    except Exception as error:
        path = without_signatures(request.rel_url.raw_path)[:200]
        if isinstance(error, SwingsError | OSError):
            log.error("%s: %s", path, error)
            message = "this stream is damaged on the server"
        else:
            log.error("%s failed", path, exc_info=error)
            message = "internal server error; see the server's log"
        if request.writer.output_size:  # cut off, so that it shows
            return gone(request)
        raise RequestError(500, message) from None


def gone(request: web.Request) -> web.Response:
    """What the log says of a client that has gone, or now does; nothing of it is sent."""
    request[SENT_BYTES] = request.writer.output_size
    connection = request.protocol
    if isinstance(connection, Connection) and connection.cut:
        request[FACTS] = {**request.get(FACTS, {}), "outcome": connection.cut}
    if request.transport is not None:
        request.transport.abort()
    return web.Response(status=CLIENT_GONE)


def refusal_of(error: web.HTTPException) -> RequestError:
    """An error of aiohttp's in our words."""
    if isinstance(error, RequestError):
        return error
    message = error.text or error.reason
    if isinstance(error, web.HTTPNotFound):
        message = "nothing is served at this URL; /v1/streams lists the streams"
    elif isinstance(error, web.HTTPMethodNotAllowed):
        message = f"this URL accepts only {error.headers['Allow']}"
    headers = {name: value for name, value in error.headers.items() if name != "Content-Type"}
    return RequestError(error.status, message, headers)


@web.middleware
async def signed(request: web.Request, handler: Handler) -> web.StreamResponse:
    """Answers only what is signed, if there are keys.

    Routes see the path with its %XX read: what needs a signature is found there, and what is signed
    is what was sent.
    """
    signer = request.app[STATE].signer
    if signer is None:
        return await handler(request)
    if request.path.startswith("/t/"):
        grant = signer.verify(request.rel_url.raw_path, time.time())
        if not isinstance(grant, Grant):
            raise AccessError(grant)
        if request.match_info.get("stream", grant.stream) != grant.stream:
            raise AccessError(Reason.SIGNATURE)
        request[GRANT] = grant
    elif needs_signature(request.path):
        raise AccessError(Reason.UNSIGNED)
    return await handler(request)


def common_headers(cors_origin: str) -> dict[str, str]:
    """The headers of every response, with the origin whose pages may read it."""
    # Without the second one, aiohttp names itself and the version of Python.
    headers = {"X-Content-Type-Options": "nosniff", "Server": "swings"}
    if cors_origin:
        headers |= {
            "Access-Control-Allow-Origin": cors_origin,
            "Access-Control-Expose-Headers": ", ".join(EXPOSED),
            "Cross-Origin-Resource-Policy": "cross-origin",
            "Timing-Allow-Origin": cors_origin,
        }
    return headers


async def complete(
    headers: Mapping[str, str], request: web.Request, response: web.StreamResponse
) -> None:
    """Completes a response when it begins. headers: of every response."""
    response.headers.update(headers)
    if GRANT in request:
        left_s = request[GRANT].expiry_s - math.ceil(time.time())
        caching = private_caching(response.headers.get("Cache-Control", ""), left_s)
        response.headers["Cache-Control"] = caching
    if WAITS_FROM_S in request:
        waited_s = asyncio.get_running_loop().time() - request[WAITS_FROM_S]
        request.app[STATE].metrics.ttfb.observe(waited_s)


async def end_plays(app: web.Application) -> None:
    """Has plays end at their next slice."""
    app[STATE].stopping.set()


async def follow_library(app: web.Application) -> AsyncIterator[None]:
    """Looks for new and changed streams."""
    async with running(app[STATE].library.watch()):
        yield


async def answer_workers(app: web.Application) -> AsyncIterator[None]:
    """Answers what the other workers of the server ask this one, on a Unix socket of its own."""
    state = app[STATE]
    if state.workers is None:
        yield
        return
    inner = web.Application(middlewares=(errors,), client_max_size=MAX_BODY_BYTES)
    inner[STATE] = state
    inner.add_routes((*statusreport.routes, *statusreport.worker_routes))
    runner = web.AppRunner(inner, access_log=None, logger=log, shutdown_timeout=WORKERS_STOP_S)
    await runner.setup()
    path = str(state.workers.path(state.number))
    await web.UnixSite(runner, path, backlog=BACKLOG).start()
    yield
    await state.workers.close()
    await runner.cleanup()


async def measure(app: web.Application, log: EventLog | None) -> AsyncIterator[None]:
    """Keeps the load and the metrics of the worker up to date."""
    state = app[STATE]
    metrics, log_dropped = state.metrics, 0

    def observe(sample: LoadSample) -> None:
        nonlocal log_dropped
        state.overload.observe(sample)
        state.busy_share = sample.busy_share
        most = max((stream.num_layers for stream in state.library.streams.values()), default=1)
        metrics.shed_layers.set(most - state.overload.max_layers(most))
        metrics.loop_late.observe(sample.late_s)
        metrics.open_connections.set(state.connections.num_held)
        metrics.streams.labels("served").set(len(state.library.streams))
        metrics.streams.labels("broken").set(len(state.library.broken))
        if log is not None:
            metrics.log_dropped.add(log.num_dropped - log_dropped)
            log_dropped = log.num_dropped
        metrics.flush()

    def late(seconds: float) -> None:
        state.lag_s = max(seconds, state.lag_s / 2)

    async with running(measure_lag(late)), running(measure_load(observe, lambda: state.sent_bytes)):
        yield
    metrics.flush()


@asynccontextmanager
async def running(work: Coroutine[Any, Any, None]) -> AsyncIterator[None]:
    """Runs `work` beside the block, and ends it."""
    task = asyncio.create_task(work)
    try:
        yield
    finally:
        task.cancel()
        await asyncio.wait([task])
