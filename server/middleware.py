"""Around every request: CORS, errors as one line of JSON, bounded sending, counting.

Rule: nothing that a client does shows up as a traceback.
"""

from __future__ import annotations

import logging
from collections.abc import Awaitable, Callable

from aiohttp import web

from codec.errors import SwingsError
from server.abr.standing import PLAY_HEADER, RATE_HEADER

from .client.connection import Connection, StalledError
from .errors import RequestError
from .state import STATE

log = logging.getLogger(__name__)

Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]

PREFLIGHT_AGE_S = 86400
"""Seconds that a browser may remember what a preflight said."""

ALLOWED_HEADERS = f"Range, If-Range, If-None-Match, Content-Type, {PLAY_HEADER}"
"""What a page of another origin may send."""

CLIENT_GONE = 499
"""Counted for a response that its client did not take to the end; nobody receives it."""


def error_response(status: int, message: str, headers: dict[str, str]) -> web.Response:
    """`message` as the JSON that every error of this server is."""
    response = web.json_response({"error": message}, status=status, headers=headers)
    response.headers["Cache-Control"] = "no-store"
    return response


@web.middleware
async def surround(request: web.Request, handler: Handler) -> web.StreamResponse:
    """Runs `handler`, sends what it gives, and counts the outcome."""
    state = request.app[STATE]
    connection = Connection(request, state.config.write_timeout_s)
    resource = request.match_info.route.resource
    route = resource.canonical if resource is not None else "unmatched"
    try:
        response = await _answer(request, handler)
        await connection.finish(response)
    except StalledError:
        state.metrics.stalled_writers.add(1, route)
        response = web.Response(status=CLIENT_GONE)
    except ConnectionError:
        state.metrics.disconnects.add(1, route)
        response = web.Response(status=CLIENT_GONE)
    state.metrics.requests.add(1, route, str(response.status))
    return response


async def _answer(request: web.Request, handler: Handler) -> web.StreamResponse:
    if request.method == "OPTIONS":
        return web.Response(
            status=204,
            headers={
                "Access-Control-Allow-Methods": "GET, HEAD, POST",
                "Access-Control-Allow-Headers": ALLOWED_HEADERS,
                "Access-Control-Max-Age": str(PREFLIGHT_AGE_S),
            },
        )
    try:
        return await handler(request)
    except RequestError as error:
        return error_response(error.status, str(error), error.headers)
    except web.HTTPException as error:
        allowed = {"Allow": error.headers["Allow"]} if "Allow" in error.headers else {}
        return error_response(error.status, error.reason, allowed)
    except (StalledError, ConnectionError):
        raise
    except (SwingsError, OSError) as error:
        # Where the files lie is the operator's business, not the client's.
        log.error("%s: %s", request.path, error)
        return _failure(request, "this stream is damaged on the server")
    except Exception:
        log.exception("%s failed", request.path)
        return _failure(request, "the server has a bug; its log says more")


def _failure(request: web.Request, message: str) -> web.Response:
    """A 500; or a cut connection, where part of another response has been sent already."""
    if request.writer.output_size and request.transport is not None:
        request.transport.abort()
        raise ConnectionResetError(message)
    return error_response(500, message, {})


async def add_headers(request: web.Request, response: web.StreamResponse) -> None:
    """The headers that every response has: who may read it from a page of another origin."""
    response.headers["X-Content-Type-Options"] = "nosniff"
    origin = request.app[STATE].config.cors_origin
    if origin:
        response.headers["Access-Control-Allow-Origin"] = origin
        response.headers["Access-Control-Expose-Headers"] = (
            "Accept-Ranges, Content-Length, Content-Range, ETag, Retry-After, "
            f"{PLAY_HEADER}, {RATE_HEADER}"
        )
        response.headers["Cross-Origin-Resource-Policy"] = "cross-origin"
        response.headers["Timing-Allow-Origin"] = origin
