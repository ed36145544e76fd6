"""One worker's server: from its first connection to the end of its last response."""

from __future__ import annotations

import asyncio
import logging
import signal
import socket
import ssl
from collections.abc import Callable, Collection, Iterable
from dataclasses import asdict
from pathlib import Path

from codec.errors import SwingsError

from .app import Application
from .clients.acceptor import Acceptor
from .clients.connection import ClientConnection
from .errors import ServerError
from .listener import bound_connections
from .operate.admission import Admission
from .operate.descriptors import connection_limit
from .operate.loadmeter import measure_load
from .operate.log.eventlog import EventLog
from .operate.overload import LoadSample
from .state.serverstate import ServerState

LAG_EVERY_S = 0.02
"""Seconds between two looks at how late the event loop is."""

log = logging.getLogger(__name__)

SHUTDOWN_SHARE = 0.9
"""Share of the shutdown time that responses get; the rest is for the remaining cleanup."""


class RunningServer:
    """The server on one socket, between `start` and `stop`."""

    def __init__(
        self, state: ServerState, listener: socket.socket, log: EventLog | None = None
    ) -> None:
        """log: where each request gets a line; None for nowhere. Raises ServerError for a
        certificate that cannot be used."""
        config = state.config
        self._state = state
        self._listener = listener
        self.app = Application(state, log)
        self._tls = None
        if config.tls_cert is not None and config.tls_key is not None:
            self._tls = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
            self._tls.minimum_version = ssl.TLSVersion.TLSv1_2
            self._tls.set_alpn_protocols(["http/1.1"])
            load_certificate(self._tls, config.tls_cert, config.tls_key)
        admission = config.admission
        most = connection_limit(admission.max_connections)
        allowed = Admission(most, admission.max_address_connections, state.proxies)
        self._acceptor = Acceptor(self.app.clients, listener, allowed, self._tls)
        self._log = log
        self._log_dropped = 0  # lines of it, counted so far
        self._peer_counts: dict[str, int] = {}  # likewise
        self._tasks: list[asyncio.Task[None]] = []

    @property
    def connections(self) -> Collection[ClientConnection]:
        """The open connections."""
        return self._acceptor.connections

    async def start(self) -> None:
        """Begins to serve, what is in the library by then."""
        state = self._state
        bound_connections(self._listener, state.config.timeouts.write_timeout_s)
        self._acceptor.start()
        self._tasks = [
            asyncio.create_task(state.library.watch()),
            asyncio.create_task(self._measure_lag()),
            asyncio.create_task(measure_load(self._observe, lambda: state.sent_bytes)),
        ]

    async def _measure_lag(self) -> None:
        """Keeps `state.lag_s` up to date."""
        clock, state = asyncio.get_running_loop().time, self._state
        while True:
            began_s = clock()
            await asyncio.sleep(LAG_EVERY_S)
            late_s = clock() - began_s - LAG_EVERY_S
            state.lag_s = max(late_s, state.lag_s / 2)

    def _observe(self, sample: LoadSample) -> None:
        state, metrics = self._state, self._state.metrics
        state.overload.observe(sample)
        state.busy_share = sample.busy_share
        most = max((stream.num_layers for stream in state.library.streams.values()), default=1)
        metrics.shed_layers.set(most - state.overload.max_layers(most))
        metrics.loop_late.observe(sample.late_s)
        metrics.open_connections.set(len(self.connections))
        metrics.streams.labels("served").set(len(state.library.streams))
        metrics.streams.labels("broken").set(len(state.library.broken))
        if state.peers is not None:
            for outcome, count in asdict(state.peers.counts).items():
                metrics.peer_messages.add(count - self._peer_counts.get(outcome, 0), outcome)
                self._peer_counts[outcome] = count
        metrics.flush()
        if self._log is not None:
            dropped = self._log.num_dropped
            metrics.log_dropped.add(dropped - self._log_dropped)
            self._log_dropped = dropped

    def renew(self) -> None:
        """Reads keys and certificate again. Those that cannot be used are logged, and the previous
        ones stay in use."""
        config = self._state.config
        try:
            self._state.read_keys()
            if self._tls is not None and config.tls_cert is not None and config.tls_key is not None:
                load_certificate(self._tls, config.tls_cert, config.tls_key)
        except (SwingsError, OSError) as error:
            log.error("keys and certificate were not reloaded: %s", error)
        else:
            log.info("keys and certificate were reloaded")

    async def stop(self) -> None:
        """Lets plays end at their next slice and answers what was asked, within
        `shutdown_timeout_s`. Stopping twice is the same as once."""
        if not self._tasks:
            return
        tasks, self._tasks = self._tasks, []
        self._state.stopping.set()
        patience_s = self._state.config.supervisor.shutdown_timeout_s
        await self._acceptor.stop(SHUTDOWN_SHARE * patience_s)
        self._listener.close()
        for task in tasks:
            task.cancel()
        await asyncio.wait(tasks)
        self._state.metrics.flush()


def load_certificate(context: ssl.SSLContext, cert: Path, key: Path) -> None:
    """Has new connections of `context` use this certificate. Raises ServerError where it cannot be
    used; then the one before it stays."""
    try:
        context.load_cert_chain(cert, key)
    except (OSError, ssl.SSLError) as error:
        raise ServerError(f"{cert} and {key} are no valid certificate and key: {error}") from error


async def run_until_stopped(
    server: RunningServer,
    ready: Callable[[], None],
    signals: Iterable[signal.Signals],
    renewing: Iterable[signal.Signals] = (),
) -> None:
    """Serves, calls `ready` once, and ends gracefully on one of `signals`; renews what it can on
    one of `renewing`.

    A second signal ends the process at once.
    """
    loop = asyncio.get_running_loop()
    for number in renewing:
        loop.add_signal_handler(number, server.renew)
    stop = asyncio.Event()
    for number in signals:
        loop.add_signal_handler(number, stop.set)
    await server.start()
    try:
        ready()
        await stop.wait()
    finally:
        for number in signals:
            loop.remove_signal_handler(number)
        await server.stop()
