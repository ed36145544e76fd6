"""One worker's server: from its first connection to the end of its last response."""

from __future__ import annotations

import asyncio
import logging
import signal
import socket
import ssl
from collections.abc import Callable, Iterable
from pathlib import Path

from codec.errors import SwingsError

from .app import common_headers, create_app
from .errors import ServerError
from .http.connection import Clients, Connection
from .http.requestlog import request_log
from .http.runner import Runner, connections
from .listener import BACKLOG, bound_connections
from .operate.log import EventLog
from .state.serverstate import ServerState

log = logging.getLogger(__name__)

SHUTDOWN_SHARE = 0.9
"""Share of the shutdown time that responses get; the rest is for the remaining cleanup."""

TLS_HANDSHAKE_S = 8.0


def create_runner(state: ServerState, log: EventLog | None = None) -> Runner:
    """The runner of one worker's application. log: where requests get a line; None for nowhere."""
    config = state.config
    logger = request_log(state.metrics, state.count_sent, state.proxies, log, config.log_requests)
    clients = Clients(state.connections, state.metrics, common_headers(config.cors_origin))
    stop_s = SHUTDOWN_SHARE * config.supervisor.shutdown_timeout_s
    keepalive_timeout_s = config.timeouts.keepalive_timeout_s
    return Runner(create_app(state, log), clients, logger, keepalive_timeout_s, stop_s)


class RunningServer:
    """The server on one socket, between `start` and `stop`."""

    def __init__(
        self, state: ServerState, listener: socket.socket, log: EventLog | None = None
    ) -> None:
        """log: where requests get a line; None for nowhere. Raises ServerError for a certificate
        that cannot be used."""
        self._state = state
        self._listener = listener
        self._runner = create_runner(state, log)
        self._server: asyncio.Server | None = None
        self._tls = None
        config = state.config
        if config.tls_cert is not None and config.tls_key is not None:
            self._tls = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
            self._tls.minimum_version = ssl.TLSVersion.TLSv1_2
            self._tls.set_alpn_protocols(["http/1.1"])
            load_certificate(self._tls, config.tls_cert, config.tls_key)

    @property
    def connections(self) -> list[Connection]:
        """The open connections."""
        return connections(self._runner.server)

    async def start(self) -> None:
        """Begins to serve, what is in the library by then."""
        bound_connections(self._listener, self._state.config.timeouts.write_timeout_s)
        await self._runner.setup()
        gate = self._runner.server
        assert gate is not None
        self._server = await asyncio.get_running_loop().create_server(
            gate,
            sock=self._listener,
            ssl=self._tls,
            ssl_handshake_timeout=None if self._tls is None else TLS_HANDSHAKE_S,
            backlog=BACKLOG,
        )

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
        server, self._server = self._server, None
        if server is None:
            return
        # When its server closes, asyncio drops accepted connections that it does not serve yet.
        asyncio.get_running_loop().remove_reader(self._listener)
        await asyncio.sleep(0)
        server.close()
        await self._runner.cleanup()


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
