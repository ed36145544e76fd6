"""State shared by the handlers of a running worker."""

from __future__ import annotations

import asyncio
import secrets
import time
from functools import partial
from pathlib import Path

from aiohttp import web

from server.html.webplayer import WebPlayer
from server.library import Library
from server.operate.admission import Admission, connection_limit, parse_proxies
from server.operate.overload import Overload
from server.operate.prometheus import Metrics
from server.operate.sign.signing import Signer, read_keys
from server.operate.workers import OtherWorkers

from .caches import ObjectCache, RecordCache
from .config import ServerConfig
from .register import PlayRegister

RECORDS_PART = 8
"""The records of plays may use 1 / RECORDS_PART of the memory for objects, in addition to it."""


class ServerState:
    """One for each worker; lives on its event loop."""

    def __init__(
        self,
        library: Library,
        config: ServerConfig,
        metrics: Metrics | None = None,
        number: int = 0,
        workers: Path | None = None,
        play_secret: bytes | None = None,
    ) -> None:
        """metrics: None for a server of one process. number: of the worker. workers: folder of the
        sockets of all; None where there is one. play_secret: shared by all workers; None for a
        server of one process. Raises InvalidError for a file of keys that is not one,
        CorruptError where it cannot be read, SwingsError if there may not be enough open files."""
        self.library = library
        self.config = config
        self.metrics = metrics or Metrics()
        self.number = number
        self.workers: OtherWorkers | None = None
        if workers is not None:
            count = partial(self.metrics.worker_requests.add, 1)
            self.workers = OtherWorkers(workers, number, count)
        self.play_secret = play_secret or secrets.token_bytes(32)
        """Authenticates the tokens of plays, see `make_token`."""
        self.began_s = time.time()
        """Unix time."""
        self.scheme = "http" if config.tls_cert is None else "https"
        """How clients call the server, where no proxy says otherwise."""
        self.proxies = parse_proxies(config.trusted_proxies)
        self.signer: Signer | None = None
        """Checks the signatures of URLs; None where they need none."""
        self.read_keys()
        self.web_player = WebPlayer()
        self.stopping = asyncio.Event()
        """Set when the server begins to stop; plays then end at the next slice."""
        self.cache = ObjectCache(config.cache_bytes, self.metrics)
        self.records = RecordCache(self.cache, config.cache_bytes // RECORDS_PART)
        self.plays = PlayRegister()
        self.overload = Overload(config.overload, config.max_plays)
        limits = config.admission
        self.play_admission = Admission(config.max_plays, limits.max_address_plays, self.proxies)
        """Plays by address."""
        most = connection_limit(limits.max_connections)
        self.connections = Admission(most, limits.max_address_connections, self.proxies)
        """Connections by address."""
        self.busy_share = 0.0
        """Share of a core that this worker used recently."""
        self.lag_s = 0.0
        """How late the event loop has been of late."""
        self.sent_bytes = 0
        """Since the worker began."""

    def read_keys(self) -> None:
        """Reads the file of keys, if there is to be one. Raises InvalidError, CorruptError."""
        if self.config.keys is not None:
            self.signer = Signer(read_keys(self.config.keys))

    def count_sent(self, num_bytes: int) -> None:
        """Counts bytes of responses."""
        self.sent_bytes += num_bytes


STATE = web.AppKey("state", ServerState)
"""Where handlers find it: request.app[STATE]."""
