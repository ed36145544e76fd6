"""The server as a process, or as several on one socket."""

from __future__ import annotations

import asyncio
import gc
import os
import secrets
import signal
import socket
import ssl
import sys
import tempfile
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from .errors import ServerError
from .library import Library
from .listener import is_loopback
from .operate.log.eventlog import EventLog, take_over_logging
from .operate.prometheus import Metrics, forget_worker
from .operate.sign.keyfile import read_keys
from .operate.watchdog import Watchdog
from .runningserver import RunningServer, load_certificate, run_until_stopped
from .state.config import ServerConfig
from .state.serverstate import ServerState

if TYPE_CHECKING:
    from .operate.workers.workerprocess import StreamWorker

STDERR = 2

SAMPLE = Path(__file__).with_name("sample") / "walk.swings"
"""Two seconds of a synthetic scene in less than a megabyte: something to see before a training."""


@dataclass(frozen=True, slots=True)
class Service:
    """The streams to serve, and how to serve them."""

    root: str
    """Folder, file or URL of a stream, or of streams."""
    config: ServerConfig
    listener: socket.socket
    play_secret: bytes = field(default_factory=partial(secrets.token_bytes, 32), repr=False)
    """Authenticates the tokens of plays. Made before the workers are forked, so that the workers of
    a renewal accept the tokens of their predecessors."""

    def run(self, ready: Callable[[], None]) -> None:
        """Serves until a signal. ready: called once, when connections are accepted.

        Raises a SwingsError or OSError for what cannot be served, or not so.
        """
        check_public(self.config, self.listener)
        log = EventLog(STDERR, self.config.log)
        watchdog = Watchdog()
        take_over_logging(log)

        def started() -> None:
            ready()
            watchdog.ready()

        if self.config.supervisor.workers == 1:

            def started_alone() -> None:
                started()
                watchdog.ping_from_loop()

            # The default on Windows is another one, which cannot watch the listener.
            with log, asyncio.Runner(loop_factory=asyncio.SelectorEventLoop) as runner:
                runner.run(self._serve(log, self.listener, started_alone))
            return
        # gunicorn can be neither imported nor installed on Windows.
        from .operate.workers.arbiter import WorkerHooks, run_workers

        with tempfile.TemporaryDirectory(prefix="swings-serve-") as folder:
            hooks = WorkerHooks(
                serve=partial(self._work, log, Path(folder)),
                log=log,
                ready=started,
                forget=partial(forget_worker, Path(folder)),
                check=self.check_files,
                ping=watchdog.ping,
            )
            run_workers(self.listener, self.config.supervisor, hooks)

    def check_files(self) -> None:
        """Reads keys and certificate. Raises a SwingsError or OSError if they cannot be used."""
        config = self.config
        if config.keys is not None:
            read_keys(config.keys)
        if config.tls_cert is not None and config.tls_key is not None:
            context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
            load_certificate(context, config.tls_cert, config.tls_key)

    async def _work(self, log: EventLog, folder: Path, worker: StreamWorker) -> None:
        """Serves in a worker process."""
        with log:
            await self._serve(log, worker.listener, worker.ready, worker, folder)

    async def _serve(
        self,
        log: EventLog,
        listener: socket.socket,
        ready: Callable[[], None],
        worker: StreamWorker | None = None,
        folder: Path | None = None,
    ) -> None:
        number = 0 if worker is None else worker.number
        metrics = Metrics(folder, number)
        library = Library(self.root, self.config.refresh_s)
        if not (library.streams or library.broken):
            log.event("no_stream_yet", "warning", root=self.root)
        state = ServerState(library, self.config, metrics, number, folder, self.play_secret)
        # The objects of now stay. Unless frozen, they cost each full collection 30 ms in which no
        # request is answered.
        gc.collect()
        gc.freeze()
        server = RunningServer(state, listener, log)
        await run_until_stopped(server, ready, *handled_signals(worker is not None))


def handled_signals(is_worker: bool) -> tuple[list[signal.Signals], list[signal.Signals]]:
    """The signals that end the event loop of a process, and those that renew its keys and
    certificate."""
    if sys.platform == "win32":  # event loops handle none there; Ctrl-C cancels the main task
        return [], []
    if is_worker:  # workers are renewed as processes
        return [signal.SIGTERM], []
    return [signal.SIGTERM, signal.SIGINT], [signal.SIGHUP]


def check_public(config: ServerConfig, listener: socket.socket) -> None:
    """Raises ServerError if other machines could reach the streams without a key, and the operator
    did not allow that."""
    if config.keys is None and not config.public and not is_loopback(listener):
        raise ServerError(
            "other machines could access all streams; give --public to allow this, "
            "or --keys FILE to require signed URLs (swings-sign)"
        )


def end_with_stdin() -> None:
    """Has this process end, like by Ctrl-C, when standard input is closed."""

    def read() -> None:
        while sys.stdin.buffer.read(4096):
            pass
        os.kill(os.getpid(), signal.SIGINT)

    threading.Thread(target=read, daemon=True).start()
