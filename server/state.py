"""What the handlers of one running server share."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, field

from aiohttp import web

from .cache import ObjectCache
from .config import ServerConfig
from .library import Library
from .metrics import Metrics


@dataclass(slots=True)
class ServerState:
    """One for each application; lives on its event loop."""

    library: Library
    config: ServerConfig
    metrics: Metrics = field(default_factory=Metrics)
    stopping: asyncio.Event = field(default_factory=asyncio.Event)
    """Set when the server begins to stop; plays then end at the next slice."""
    active_plays: int = 0
    cache: ObjectCache = field(init=False)

    def __post_init__(self) -> None:
        self.cache = ObjectCache(self.config.cache_bytes, self.metrics)


STATE = web.AppKey("state", ServerState)
