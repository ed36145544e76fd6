"""POST /v1/streams/{stream}/play/{play}: a client tells how its playback stands.

Rule: a flood of news costs what its requests cost, and no more. The play looks at the newest only,
when it would look at its client anyway.
"""

from __future__ import annotations

import asyncio

from aiohttp import web

from codec.errors import InvalidError
from server.abr.standing import MAX_BODY_BYTES, RATE_HEADER, Standing

from .client.register import NewsOutcome
from .errors import RequestError
from .state import STATE


async def take_news(request: web.Request) -> web.StreamResponse:
    """204, or an error that says what is wrong with it."""
    state = request.app[STATE]
    token, stream = request.match_info["play"], request.match_info["stream"]
    outcome = NewsOutcome.REFUSED
    try:
        # Before the body is read: who names no play may send nothing.
        if state.plays.find(token, stream) is None:
            outcome = NewsOutcome.UNKNOWN
        else:
            news = Standing.from_json(await _body(request, state.config.write_timeout_s))
            outcome = state.plays.tell(token, stream, news)
    except InvalidError as error:
        raise RequestError(400, f"news of a play: {error}") from error
    finally:
        state.metrics.play_news.add(1, outcome)
    if outcome is NewsOutcome.UNKNOWN:
        raise RequestError(404, "there is no such play, or it is over")
    headers = {"Cache-Control": "no-store"}
    entry = state.plays.find(token, stream)
    if entry is not None and entry.rate_bps is not None:
        headers[RATE_HEADER] = str(round(entry.rate_bps))
    return web.Response(status=204, headers=headers)


async def _body(request: web.Request, timeout_s: float) -> bytes:
    """The body. Raises RequestError for one that is too long, broken, or does not come."""
    body = bytearray()
    try:
        async with asyncio.timeout(timeout_s):
            async for piece in request.content.iter_any():
                body += piece
                if len(body) > MAX_BODY_BYTES:
                    raise RequestError(413, f"news of a play takes {MAX_BODY_BYTES} bytes at most")
    except TimeoutError as error:
        raise RequestError(408, "the news of a play did not come whole") from error
    except web.RequestPayloadError as error:
        message = "the news of a play cannot be read"
        raise RequestError(400, message, {"Connection": "close"}) from error
    return bytes(body)
