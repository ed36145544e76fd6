"""The server as a process of its own, from its first connection to the end of its last response;
and how it becomes gunicorn where there are to be several."""

from __future__ import annotations

import asyncio
import gc
import logging
import os
import signal
import socket
import ssl
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import NoReturn

from codec.errors import SwingsError
from codec.stream.packedstorage import open_place
from server.http.connection import Runner
from server.http.errors import ServerError
from server.http.requestlog import request_log
from server.operate.log import STDERR, EventLog, take_over_logging
from server.operate.prometheus import Metrics
from server.operate.settings import settings_variables
from server.operate.sign.signing import read_keys
from server.operate.watchdog import Watchdog
from server.state.config import ServerConfig
from server.state.serverstate import ServerState

from .app import common_headers, create_app
from .library import Library
from .listener import BACKLOG, bound_connections
from .servecommand import PREFIX, ServeCommand

log = logging.getLogger(__name__)

SHUTDOWN_SHARE = 0.9
"""Share of the shutdown time that responses get; the rest is for the remaining cleanup."""

TLS_HANDSHAKE_S = 8.0


class RunningServer(Runner):
    """The server on one socket, between `start` and `stop`; gunicorn's workers run it as they run
    any AppRunner."""

    def __init__(self, state: ServerState, log: EventLog | None = None) -> None:
        """log: where requests get a line; None for nowhere."""
        config = state.config
        super().__init__(
            create_app(state, log),
            state.connections,
            state.metrics,
            common_headers(config.cors_origin),
            request_log(state.metrics, state.count_sent, state.proxies, log, config.log_requests),
            config.timeouts.keepalive_timeout_s,
            SHUTDOWN_SHARE * config.supervisor.shutdown_timeout_s,
        )
        self._state = state
        self._tls: ssl.SSLContext | None = None
        self._accepting: asyncio.Server | None = None

    async def start(self, listener: socket.socket) -> None:
        """Begins to serve, what is in the library by then. Raises ServerError for a certificate
        that cannot be used."""
        config = self._state.config
        bound_connections(listener, config.timeouts.write_timeout_s)
        self._tls = tls_context(config)
        await self.setup()
        self._accepting = await asyncio.get_running_loop().create_server(
            self.server,
            sock=listener,
            ssl=self._tls,
            ssl_handshake_timeout=None if self._tls is None else TLS_HANDSHAKE_S,
            backlog=BACKLOG,
        )

    def renew(self) -> None:
        """Reads keys and certificate again. Those that cannot be used are logged, and the previous
        ones stay in use."""
        try:
            self._state.read_keys()
            if self._tls is not None:
                load_certificate(self._tls, self._state.config)
        except (SwingsError, OSError) as error:
            log.error("keys and certificate were not reloaded: %s", error)
        else:
            log.info("keys and certificate were reloaded")

    async def stop(self) -> None:
        """Lets plays end at their next slice and answers what was asked, within
        `shutdown_timeout_s`. Stopping twice is the same as once."""
        accepting, self._accepting = self._accepting, None
        if accepting is None:
            return
        # When its server closes, asyncio drops accepted connections that it does not serve yet.
        for listener in accepting.sockets:
            asyncio.get_running_loop().remove_reader(listener)
        await asyncio.sleep(0)
        accepting.close()
        await self.cleanup()


def tls_context(config: ServerConfig) -> ssl.SSLContext | None:
    """What new connections use; None where they are to have no TLS. Raises ServerError."""
    if config.tls_cert is None:
        return None
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    context.set_alpn_protocols(["http/1.1"])
    load_certificate(context, config)
    return context


def load_certificate(context: ssl.SSLContext, config: ServerConfig) -> None:
    """Has new connections of `context` use the certificate. Raises ServerError where it cannot be
    used; then the one before it stays."""
    cert, key = config.tls_cert, config.tls_key
    assert cert is not None
    try:
        context.load_cert_chain(cert, key)
    except (OSError, ssl.SSLError) as error:
        raise ServerError(f"{cert} and {key} are no valid certificate and key: {error}") from error


def serve_alone(command: ServeCommand, listener: socket.socket, ready: Callable[[], None]) -> None:
    """Serves in this process until a signal; a second one ends it at once, and SIGHUP renews keys
    and certificate. ready: called once, when connections are accepted.

    Raises a SwingsError or OSError for what cannot be served, or not so.
    """
    config = command.server
    log = EventLog(STDERR, config.log)
    watchdog = Watchdog()
    take_over_logging(log)
    if command.end_with_stdin:
        end_with_stdin(os.getpid())

    async def serve() -> None:
        server = RunningServer(make_state(command.place, config, log), log)
        loop, stop = asyncio.get_running_loop(), asyncio.Event()
        ends = [signal.SIGTERM, signal.SIGINT]
        if sys.platform == "win32":  # event loops handle none there; Ctrl-C cancels the main task
            ends = []
        else:
            loop.add_signal_handler(signal.SIGHUP, server.renew)
        for number in ends:
            loop.add_signal_handler(number, stop.set)
        await server.start(listener)
        try:
            ready()
            watchdog.ready()
            await stop.wait()
        finally:
            for number in ends:
                loop.remove_signal_handler(number)
            await server.stop()

    # The default on Windows is another one, which cannot watch the listener.
    with log, asyncio.Runner(loop_factory=asyncio.SelectorEventLoop) as runner:
        runner.run(serve())


def serve_with_workers(
    command: ServeCommand, listener: socket.socket, ready: Callable[[], None]
) -> NoReturn:
    """Becomes gunicorn, whose workers serve on `listener`; see gunicornconf. ready: called before,
    as the socket listens already. Raises a CodecError for a place that is not there."""
    open_place(command.place).check()
    ready()
    os.set_inheritable(listener.fileno(), True)
    words = (
        # -P: else a folder of the user's that is called server would be taken for this package.
        *(sys.executable, "-P", "-m", "gunicorn"),
        *("--config", "python:server.gunicornconf"),
        *("--bind", f"fd://{listener.fileno()}", "server.gunicornconf:create"),
    )
    os.execve(sys.executable, words, os.environ | settings_variables(PREFIX, command))


def make_state(
    place: str,
    config: ServerConfig,
    log: EventLog,
    number: int = 0,
    folder: Path | None = None,
    play_secret: bytes | None = None,
) -> ServerState:
    """The state of a process that serves `place`. number, folder, play_secret: of a worker, see
    ServerState. Raises a SwingsError or OSError for what cannot be served."""
    library = Library(place, config.refresh_s)
    if not (library.streams or library.broken):
        log.event("no_stream_yet", "warning", root=place)
    state = ServerState(library, config, Metrics(folder, number), number, folder, play_secret)
    # The objects of now stay. Unless frozen, they cost each full collection 30 ms in which no
    # request is answered.
    gc.collect()
    gc.freeze()
    return state


def check_files(config: ServerConfig) -> None:
    """Reads keys and certificate. Raises a SwingsError or OSError if they cannot be used."""
    if config.keys is not None:
        read_keys(config.keys)
    tls_context(config)


def end_with_stdin(pid: int) -> None:
    """Has process `pid` end, like by Ctrl-C, when standard input is closed."""

    def read() -> None:
        while sys.stdin.buffer.read(4096):
            pass
        os.kill(pid, signal.SIGINT)

    threading.Thread(target=read, daemon=True).start()
