"""The server as a process, or as several on one socket."""

from __future__ import annotations

import asyncio
import signal
import socket
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from .answers.news import answer_peer
from .errors import ServerError
from .library import Library
from .listener import is_loopback
from .operate.log.eventlog import EventLog, RecordHandler, take_over_logging
from .operate.prometheus import Metrics, forget_worker
from .operate.workers.peers import Peers
from .operate.workers.supervisor import Supervisor, Worker
from .runningserver import RunningServer, run_until_stopped
from .state.config import ServerConfig
from .state.serverstate import ServerState

STDERR = 2


@dataclass(frozen=True, slots=True)
class Service:
    """What is served, and how."""

    root: str
    """Folder or URL of a stream, or of streams."""
    config: ServerConfig
    listener: socket.socket

    def run(self, ready: Callable[[], None]) -> None:
        """Serves until a signal. ready: called once, when connections are accepted.

        Raises a SwingsError or OSError for what cannot be served, or not so.
        """
        check_public(self.config, self.listener)
        log = EventLog(STDERR, self.config.log)
        if self.config.supervisor.workers == 1:
            with log.writer:
                take_over_logging(RecordHandler(log))
                # The default on Windows is another one, which cannot watch the listener.
                with asyncio.Runner(loop_factory=asyncio.SelectorEventLoop) as runner:
                    runner.run(self._serve(log, ready))
            return
        with tempfile.TemporaryDirectory(prefix="swings-serve-") as folder:
            supervisor = Supervisor(
                self.listener,
                partial(self._work, log, Path(folder)),
                self.config.supervisor,
                log.event,
                partial(forget_worker, Path(folder)),
            )
            supervisor.run(ready)

    def _work(self, log: EventLog, folder: Path, worker: Worker) -> None:
        """What a worker process does."""
        with log.writer:
            take_over_logging(RecordHandler(log))
            asyncio.run(self._serve(log, worker.ready, worker, folder))

    async def _serve(
        self,
        log: EventLog,
        ready: Callable[[], None],
        worker: Worker | None = None,
        folder: Path | None = None,
    ) -> None:
        number = 0 if worker is None else worker.number
        peers = None if worker is None else Peers(number, worker.mailboxes)
        metrics = Metrics(folder, number)
        library = Library(self.root, self.config.refresh_s)
        if not (library.streams or library.broken):
            log.trouble("no_stream_yet", "warning", root=self.root)
        state = ServerState(library, self.config, metrics, number, peers)
        if peers is not None:
            clock = asyncio.get_running_loop().time
            peers.on_request = lambda question: answer_peer(state, question, clock())
            peers.start()
        try:
            server = RunningServer(state, self.listener, log)
            await run_until_stopped(server, ready, *handled_signals(worker is not None))
        finally:
            if peers is not None:
                peers.close()


def handled_signals(is_worker: bool) -> tuple[list[signal.Signals], list[signal.Signals]]:
    """The signals that end the event loop of a process, and those that renew its keys and
    certificate."""
    if sys.platform == "win32":  # event loops handle none there; Ctrl-C cancels the main task
        return [], []
    if is_worker:  # workers are renewed as processes
        return [signal.SIGTERM], []
    return [signal.SIGTERM, signal.SIGINT], [signal.SIGHUP]


def check_public(config: ServerConfig, listener: socket.socket) -> None:
    """Raises ServerError where everybody would see what nobody said that everybody may see."""
    if config.keys is None and not config.public and not is_loopback(listener):
        raise ServerError(
            "other machines could access all streams; give --public to allow this, "
            "or --keys FILE to require signed URLs (swings-sign)"
        )
