"""What the handlers of one running server share, and how they find the stream of a request."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, field

from aiohttp import web

from .cache import ObjectCache
from .client.register import PlayRegister
from .config import ServerConfig
from .errors import RequestError
from .html.webplayer import WebPlayer
from .library import Library, ServedStream
from .metrics import Metrics


@dataclass(slots=True)
class ServerState:
    """One for each application; lives on its event loop."""

    library: Library
    config: ServerConfig
    metrics: Metrics = field(default_factory=Metrics)
    web_player: WebPlayer = field(default_factory=WebPlayer)
    stopping: asyncio.Event = field(default_factory=asyncio.Event)
    """Set when the server begins to stop; plays then end at the next slice."""
    cache: ObjectCache = field(init=False)
    plays: PlayRegister = field(init=False)

    def __post_init__(self) -> None:
        self.cache = ObjectCache(self.config.cache_bytes, self.metrics)
        self.plays = PlayRegister(self.config.remember_plays, self.config.remember_s)


STATE = web.AppKey("state", ServerState)


async def find_stream(request: web.Request) -> ServedStream:
    """The stream that the URL names, as it is now. Raises RequestError 404 where there is none."""
    name = request.match_info["stream"]
    stream = request.app[STATE].library.find(name)
    if stream is None:
        raise RequestError(404, f"no stream is called {name[:80]!r}; /v1/streams lists them")
    return stream
