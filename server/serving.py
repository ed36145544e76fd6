"""The server as a process, or as several on one socket."""

from __future__ import annotations

import asyncio
import gc
import os
import signal
import socket
import ssl
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import NoReturn

from .errors import ServerError
from .library import Library
from .listener import is_loopback
from .operate.log import STDERR, EventLog, take_over_logging
from .operate.prometheus import Metrics
from .operate.settings import settings_variables
from .operate.sign.keyfile import read_keys
from .operate.watchdog import Watchdog
from .runningserver import RunningServer, load_certificate, run_until_stopped
from .servecommand import PREFIX, ServeCommand
from .state.config import ServerConfig
from .state.serverstate import ServerState


def serve_alone(command: ServeCommand, listener: socket.socket, ready: Callable[[], None]) -> None:
    """Serves in this process until a signal. ready: called once, when connections are accepted.

    Raises a SwingsError or OSError for what cannot be served, or not so.
    """
    config = command.server
    log = EventLog(STDERR, config.log)
    watchdog = Watchdog()
    take_over_logging(log)
    if command.end_with_stdin:
        end_with_stdin(os.getpid())

    def started() -> None:
        ready()
        watchdog.ready()

    async def serve() -> None:
        server = RunningServer(make_state(command.place, config, log), listener, log)
        await run_until_stopped(server, started, *handled_signals())

    # The default on Windows is another one, which cannot watch the listener.
    with log, asyncio.Runner(loop_factory=asyncio.SelectorEventLoop) as runner:
        runner.run(serve())


def serve_with_workers(command: ServeCommand, listener: socket.socket) -> NoReturn:
    """Becomes gunicorn, whose workers serve on `listener`; see gunicornconf."""
    os.set_inheritable(listener.fileno(), True)
    words = (
        # -P: else a folder of the user's that is called server would be taken for this package.
        *(sys.executable, "-P", "-m", "gunicorn"),
        *("--config", "python:server.gunicornconf"),
        *("--bind", f"fd://{listener.fileno()}", "server.factory:create"),
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
    if config.tls_cert is not None and config.tls_key is not None:
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        load_certificate(context, config.tls_cert, config.tls_key)


def check_public(config: ServerConfig, listener: socket.socket) -> None:
    """Raises ServerError if other machines could reach the streams without a key, and the operator
    did not allow that."""
    if config.keys is None and not config.public and not is_loopback(listener):
        raise ServerError(
            "other machines could access all streams; give --public to allow this, "
            "or --keys FILE to require signed URLs (swings-sign)"
        )


def handled_signals() -> tuple[list[signal.Signals], list[signal.Signals]]:
    """The signals that end the event loop of a process, and those that renew its keys and
    certificate."""
    if sys.platform == "win32":  # event loops handle none there; Ctrl-C cancels the main task
        return [], []
    return [signal.SIGTERM, signal.SIGINT], [signal.SIGHUP]


def end_with_stdin(pid: int) -> None:
    """Has process `pid` end, like by Ctrl-C, when standard input is closed."""

    def read() -> None:
        while sys.stdin.buffer.read(4096):
            pass
        os.kill(pid, signal.SIGINT)

    threading.Thread(target=read, daemon=True).start()
