"""From a request to the stream that its URL names."""

from __future__ import annotations

import asyncio

from aiohttp import web

from .errors import RequestError
from .library import ServedStream
from .state import STATE


async def find_stream(request: web.Request) -> ServedStream:
    """The stream that the URL names, as it is now. Raises RequestError 404 where there is none."""
    name = request.match_info["stream"]
    now_s = asyncio.get_running_loop().time()
    stream = await request.app[STATE].library.find(name, now_s)
    if stream is None:
        raise RequestError(404, f"no stream is called {name[:80]!r}; /v1/streams lists them")
    return stream
