"""gunicorn's arbiter, embedded: starts workers on one listening socket, replaces those that die or
hang, and ends them in time.

Rule: the arbiter serves no requests and starts no threads. SIGTERM or SIGINT ends it, a second one
at once; SIGHUP renews the workers. Its settings are given here: gunicorn's command line, files and
variables are not read.
"""

from __future__ import annotations

import logging
import math
import os
import signal
import socket
import time
from collections.abc import Callable, Coroutine, Iterable
from dataclasses import dataclass
from types import FrameType
from typing import Any, ClassVar, NoReturn

import gunicorn.util
from gunicorn.app.base import BaseApplication
from gunicorn.arbiter import Arbiter
from gunicorn.errors import HaltServer
from gunicorn.glogging import Logger

from codec.errors import SwingsError
from server.operate.log.eventlog import EventLog
from server.operate.log.logline import Value

from .supervisorconfig import SupervisorConfig
from .workerprocess import StreamWorker

EARLY_S = 1.0
"""A worker that dies sooner after its start delays the next start."""

FIRST_DELAY_S, MAX_DELAY_S = 0.1, 10.0
"""Delay after the second early death in a row; each further one doubles it."""

SHARED_MEMORY = "/dev/shm"
"""Folder for the files of heartbeats, where there is one: a disk could delay them."""


@dataclass(frozen=True, slots=True, kw_only=True)
class WorkerHooks:
    """Callbacks of the arbiter."""

    serve: Callable[[StreamWorker], Coroutine[Any, Any, None]]
    """Serves, in a worker, until SIGTERM. A SwingsError or OSError is logged in one line."""
    log: EventLog
    ready: Callable[[], None] = lambda: None
    """Called once, when the first worker accepts connections."""
    forget: Callable[[int], None] = lambda _: None
    """Called with the number of each worker that has ended, before another worker gets it."""
    check: Callable[[], None] = lambda: None
    """Called before workers are renewed; a SwingsError or OSError leaves the old ones in place."""
    ping: Callable[[], None] = lambda: None
    """Called at least once a second as long as the arbiter works."""


def restart_delay_s(num_early: int) -> float:
    """Seconds until the next start after `num_early` early deaths in a row."""
    if num_early < 2:
        return 0.0
    return min(MAX_DELAY_S, FIRST_DELAY_S * 2.0 ** min(num_early - 2, 64))


def run_workers(listener: socket.socket, config: SupervisorConfig, hooks: WorkerHooks) -> None:
    """Returns when all workers have ended after a signal. Takes over `listener`.

    Raises SwingsError if a worker fails before any was ready.
    """
    gunicorn.util._setproctitle = lambda title: None  # type: ignore[attr-defined]
    application = WorkerApplication(listener, config, hooks)
    arbiter = _Arbiter(application)
    try:
        arbiter.run()
    except SystemExit as end:
        if end.code:
            raise
    if arbiter.failure:
        raise SwingsError(arbiter.failure)


class _Log(Logger):
    """Warnings and errors of gunicorn, as records for the handlers that are there."""

    def setup(self, cfg: Any) -> None:
        self.cfg = cfg
        self.error_log.propagate = True
        self.error_log.setLevel(logging.WARNING)


class WorkerApplication(BaseApplication):
    """Settings of gunicorn, and what workers need."""

    def __init__(
        self, listener: socket.socket, config: SupervisorConfig, hooks: WorkerHooks
    ) -> None:
        self.hooks = hooks
        self.event = hooks.log.event
        self.count = config.workers
        self.shutdown_timeout_s = config.shutdown_timeout_s
        self._settings = {
            "bind": f"fd://{listener.detach()}",
            "workers": config.workers,
            "worker_class": StreamWorker,
            "logger_class": _Log,
            "timeout": config.worker_timeout_s,
            "graceful_timeout": math.ceil(config.shutdown_timeout_s),
            "worker_tmp_dir": SHARED_MEMORY if os.access(SHARED_MEMORY, os.W_OK) else None,
            "control_socket_disable": True,
            "pre_fork": lambda arbiter, worker: arbiter.number(worker),
            "child_exit": lambda arbiter, worker: arbiter.bury(worker),
        }
        super().__init__(prog="swings-serve")

    def load_config(self) -> None:
        for name, value in self._settings.items():
            self.cfg.set(name, value)


class _Arbiter(Arbiter):
    """With restarts that are delayed in a crash loop, and renewals in which the new workers serve
    before the old ones end."""

    # The others keep their default action; gunicorn would start another program on SIGUSR2.
    SIGNALS: ClassVar = [signal.SIGHUP, signal.SIGINT, signal.SIGTERM]
    WORKERS: ClassVar[dict[int, StreamWorker]]  # type: ignore[assignment]
    app: WorkerApplication

    def __init__(self, app: WorkerApplication) -> None:
        self.failure = ""
        """Why no worker could start."""
        self._was_ready = False
        self._stopping = False
        self._renewal_wanted = False
        self._renewed_age = 0  # workers of a higher age are those of the renewal under way
        self._num_early = 0
        self._spawn_s = 0.0  # no worker is started before
        super().__init__(app)

    def signal(self, sig: int, frame: FrameType | None) -> None:
        # Both end gracefully, and a second one at once; gunicorn does so for a second SIGINT only.
        super().signal(signal.SIGINT if sig == signal.SIGTERM else sig, frame)

    def handle_int(self) -> NoReturn:
        self.app.event("stopping", workers=len(self.WORKERS))
        self._stopping = True
        raise StopIteration

    def handle_hup(self) -> None:
        try:
            self.app.hooks.check()
        except (SwingsError, OSError) as error:
            self.app.event("renewal_failed", error=str(error))
        else:
            self._renewal_wanted = True

    def manage_workers(self) -> None:
        self.app.hooks.ping()
        self._look_for_ready(self.WORKERS.values())
        count = self.app.count
        if self.num_workers > count:
            new = [w for w in self.WORKERS.values() if w.age > self._renewed_age and w.is_ready]
            if len(new) >= count:
                self.num_workers = count  # the oldest ones are ended
        elif self._renewal_wanted and len(self.WORKERS) <= count:
            self._renewal_wanted = False
            self._renewed_age = self.worker_age
            self.num_workers = 2 * count
        super().manage_workers()

    def _look_for_ready(self, workers: Iterable[StreamWorker]) -> None:
        if not self._was_ready and any(worker.is_ready for worker in workers):
            self._was_ready = True
            self.app.hooks.ready()

    def spawn_workers(self) -> None:
        if time.monotonic() < self._spawn_s:
            return
        try:
            super().spawn_workers()
        except OSError as error:
            self._spawn_s = time.monotonic() + EARLY_S
            self.app.event("worker_not_started", error=str(error))

    def spawn_worker(self) -> int:
        # A signal in between would be taken by the arbiter's handlers in the worker.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, self.SIGNALS)
        try:
            return super().spawn_worker()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)

    def number(self, worker: StreamWorker) -> None:
        """Gives a worker that will be forked its number."""
        taken = {other.number for other in self.WORKERS.values()}
        worker.number = next(n for n in range(2 * self.app.count) if n not in taken)

    def kill_worker(self, pid: int, sig: int) -> None:
        """Sends SIGTERM once, and SIGKILL when the time to end is over."""
        worker, now_s = self.WORKERS[pid], time.monotonic()
        if sig == signal.SIGTERM:
            if worker.kill_s is None:
                worker.kill_s = now_s + self.app.shutdown_timeout_s
            elif now_s < worker.kill_s:
                return
            else:
                sig = signal.SIGKILL
        if sig == signal.SIGKILL:
            self.app.event("worker_killed", worker=worker.number, pid=pid)
        super().kill_worker(pid, sig)

    def reap_workers(self) -> None:
        self.app.hooks.ping()  # while it stops, this is what is called again and again
        super().reap_workers()

    def bury(self, worker: StreamWorker) -> None:
        """Decides what follows from the end of a worker."""
        now_s = time.monotonic()
        lived_s = now_s - worker.began_s
        self.app.hooks.forget(worker.number)
        self._look_for_ready([worker])  # it may have died before the arbiter looked
        fields: dict[str, Value] = {
            "worker": worker.number,
            "pid": worker.pid,
            "lived_s": round(lived_s, 3),
            "error": worker.failure or None,
        }
        if self.failure:
            return
        if worker.kill_s is not None or self._stopping:
            self.app.event("worker_ended", **fields)
        elif not self._was_ready:
            self.failure = worker.failure or "a worker ended at start-up; the log says why"
            raise HaltServer(self.failure, 0)
        else:
            self._num_early = self._num_early + 1 if lived_s < EARLY_S else 0
            delay_s = restart_delay_s(self._num_early)
            self._spawn_s = now_s + delay_s
            self.app.event("worker_died", **fields, restart_s=delay_s)
