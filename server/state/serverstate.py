"""What the handlers of one running server share."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, field

from server.html.webplayer import WebPlayer
from server.library import Library

from .config import ServerConfig
from .metrics import Metrics
from .objectcache import ObjectCache
from .recordcache import RecordCache
from .register import PlayRegister

RECORDS_PART = 8
"""Of so many parts of the memory for objects, one is for the records of plays besides."""


@dataclass(slots=True)
class ServerState:
    """One for each application; lives on its event loop."""

    library: Library
    config: ServerConfig
    scheme: str = "http"
    """http or https: how clients call the server."""
    metrics: Metrics = field(default_factory=Metrics)
    web_player: WebPlayer = field(default_factory=WebPlayer)
    stopping: asyncio.Event = field(default_factory=asyncio.Event)
    """Set when the server begins to stop; plays then end at the next slice."""
    cache: ObjectCache = field(init=False)
    records: RecordCache = field(init=False)
    plays: PlayRegister = field(init=False)

    def __post_init__(self) -> None:
        self.cache = ObjectCache(self.config.cache_bytes, self.metrics)
        self.records = RecordCache(self.cache, self.config.cache_bytes // RECORDS_PART)
        self.plays = PlayRegister(self.config.remember_plays, self.config.remember_s)
