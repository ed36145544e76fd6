"""Starts workers on one listening socket, and starts them again; ends them in time.

One socket, and not one for each worker: connections that wait for a worker that dies are taken by
the others, and none is refused.

Rule: the parent serves nobody, starts no thread and reads nothing of a client. SIGTERM or SIGINT
ends, a second one at once; SIGHUP renews the workers, each new one before its old one goes.
"""

from __future__ import annotations

import math
import os
import random
import select
import signal
import socket
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Protocol

from codec.errors import InvalidError, SwingsError
from server.operate.log.logline import Value

from .backoff import Backoff, BackoffConfig
from .forking import fork_worker
from .mailboxes import Mailboxes

_SIGNAL_NAMES = {number.value: number.name for number in signal.Signals}

MAX_WORKERS = 256

RENEWAL_S = 60.0
"""Seconds in which a new worker must be ready to take the place of an old one."""

LOOK_S = 60.0
"""How often the supervisor looks around if nothing happens."""

SIGNALS: tuple[signal.Signals, ...] = (signal.SIGTERM, signal.SIGINT)
if sys.platform != "win32":
    SIGNALS += (signal.SIGHUP, signal.SIGCHLD)


@dataclass(frozen=True, slots=True)
class SupervisorConfig:
    """Number, shutdown and restart of the worker processes."""

    workers: int = 1
    """Number of worker processes; use one for each core that is to serve."""
    shutdown_timeout_s: float = 10.0
    """Seconds that workers have to shut down before they are killed."""
    backoff: BackoffConfig = field(default_factory=BackoffConfig)
    """Delays before workers that died are restarted."""

    def __post_init__(self) -> None:
        if not 1 <= self.workers <= MAX_WORKERS:
            raise InvalidError(f"workers is {self.workers}; give 1 to {MAX_WORKERS}")
        if self.workers > 1 and not sys.platform.startswith("linux"):
            raise InvalidError(f"workers is {self.workers}; more than 1 needs Linux; give 1")
        if not 0 < self.shutdown_timeout_s < math.inf:
            raise InvalidError(
                f"shutdown_timeout_s is {self.shutdown_timeout_s}; it must be positive"
            )


@dataclass(frozen=True, slots=True)
class Worker:
    """What a worker is given."""

    number: int
    """Its place, from 0 to 2 * count - 1: no two that live have the same. While workers are
    renewed there are more of them than `count`."""
    count: int
    """Workers that serve in all, as a rule."""
    listener: socket.socket
    """The listening socket, which all share."""
    mailboxes: Mailboxes
    """Where workers send each other messages."""
    ready: Callable[[], None]
    """Must be called once, when it accepts connections."""


class Tell(Protocol):
    """Writes one line into the log."""

    def __call__(self, event: str, /, **fields: Value) -> None: ...


@dataclass(slots=True)
class _Child:
    """A process that was started and is not reaped."""

    pid: int
    place: int
    lane: _Lane
    news: int  # pipe: one NUL when it is ready, or why it is not
    began_s: float
    is_ready: bool = False
    trouble: str = ""
    told_to_end: bool = False
    kill_s: float | None = None  # when it is killed


@dataclass(slots=True)
class _Lane:
    """One of `count` workers, with its predecessors and successors."""

    backoff: Backoff
    child: _Child | None = None
    fresh: _Child | None = None  # takes the place of `child` when it is ready
    due_s: float | None = 0.0  # when a child is started, where there is none


class Supervisor:
    """Runs workers until it is told to stop."""

    def __init__(
        self,
        listener: socket.socket,
        run: Callable[[Worker], None],
        config: SupervisorConfig,
        tell: Tell,
        forget: Callable[[int], None] = lambda _: None,
    ) -> None:
        """listener: closed when the supervisor stops. run: what a worker does. On SIGTERM it must
        end by itself, and write out its log before it returns. A SwingsError or OSError that it
        raises is told in the log; where none was ever ready it ends the supervisor. tell: for the
        log. forget: called with the number of each worker that has ended, before another gets it.
        """
        self._listener = listener
        self._run = run
        self._config = config
        self._tell = tell
        self._forget = forget
        self._mailboxes = Mailboxes(2 * config.workers)
        self._lanes = [_Lane(Backoff(config.backoff, random.random)) for _ in range(config.workers)]
        self._children: dict[int, _Child] = {}
        self._to_renew: list[_Lane] = []
        self._renew_again = False
        self._stopping = False
        self._was_ready = False
        self._failure = ""

    def run(self, ready: Callable[[], None] = lambda: None) -> None:
        """Returns when all workers have ended after a signal. ready: called when the first worker
        accepts. Raises SwingsError where the first workers cannot start."""
        with _caught_signals() as caught:
            try:
                while not (self._stopping and not self._children):
                    was_ready = self._was_ready
                    self._start_what_is_due()
                    for number in self._wait(caught):
                        self._take_signal(number)
                    self._reap()
                    self._kill_what_is_late()
                    if self._was_ready and not was_ready:
                        ready()
            finally:
                # Only after a bug of ours are there any.
                for child in self._children.values():
                    os.kill(child.pid, signal.SIGKILL)
                self._mailboxes.close()
        if self._failure:
            raise SwingsError(self._failure)

    # Starting.

    def _start_what_is_due(self) -> None:
        if self._stopping:
            return
        now_s = time.monotonic()
        for lane in self._lanes:
            if lane.child is None and lane.due_s is not None and now_s >= lane.due_s:
                lane.child = self._fork(lane)
        if not self._to_renew and self._renew_again:
            self._renew_again = False
            self._to_renew = list(self._lanes)
        # One after the other: so the machine never starts more than one besides those that serve.
        if self._to_renew and not any(lane.fresh for lane in self._lanes):
            lane = self._to_renew[0]
            if len(self._children) < 2 * self._config.workers:
                lane.fresh = self._fork(lane)
                if lane.fresh is not None:
                    lane.fresh.kill_s = now_s + RENEWAL_S

    def _fork(self, lane: _Lane) -> _Child | None:
        taken = {child.place for child in self._children.values()}
        place = next(n for n in range(2 * self._config.workers) if n not in taken)
        lane.due_s = None

        def work(ready: Callable[[], None]) -> None:
            for child in self._children.values():
                os.close(child.news)
            self._run(Worker(place, self._config.workers, self._listener, self._mailboxes, ready))

        try:
            pid, news = fork_worker(work, SIGNALS)
        except OSError as error:
            delay_s = lane.backoff.died(0.0)
            lane.due_s = time.monotonic() + max(delay_s, self._config.backoff.first_s)
            self._tell("worker_not_started", worker=place, error=str(error))
            return None
        child = _Child(pid, place, lane, news, time.monotonic())
        self._children[pid] = child
        return child

    # What happens.

    def _wait(self, caught: socket.socket) -> bytes:
        """Waits for something to happen; gives the numbers of the signals that came."""
        now_s = time.monotonic()
        times = [lane.due_s for lane in self._lanes if not self._stopping and lane.child is None]
        times += [child.kill_s for child in self._children.values()]
        due_s = min([now_s + LOOK_S, *(time_s for time_s in times if time_s is not None)])
        poll = select.poll()
        poll.register(caught, select.POLLIN)
        by_news = {c.news: c for c in self._children.values() if not (c.is_ready or c.trouble)}
        for news in by_news:
            poll.register(news, select.POLLIN)
        found = poll.poll(max(0, math.ceil((due_s - now_s) * 1000)))
        numbers = b""
        for descriptor, _ in found:
            if descriptor in by_news:
                self._hear(by_news[descriptor])
            else:
                numbers = caught.recv(4096)
        return numbers

    def _hear(self, child: _Child) -> None:
        """Reads what a worker says of itself."""
        try:
            said = os.read(child.news, 65536)
        except BlockingIOError:
            return
        if said.startswith(b"\0"):
            child.is_ready = self._was_ready = True
            said = said[1:]
            self._tell("worker_ready", worker=child.place, pid=child.pid)
            if child is child.lane.fresh:
                self._change_over(child)
        child.trouble = child.trouble or said.decode(errors="replace")

    def _change_over(self, fresh: _Child) -> None:
        """A new worker accepts: its old one may go."""
        lane, fresh.kill_s = fresh.lane, None
        old, lane.child, lane.fresh, lane.due_s = lane.child, fresh, None, None
        if lane in self._to_renew:
            self._to_renew.remove(lane)
        if old is not None:
            self._end(old)

    def _end(self, child: _Child) -> None:
        if not child.told_to_end:
            child.told_to_end = True
            child.kill_s = time.monotonic() + self._config.shutdown_timeout_s
            os.kill(child.pid, signal.SIGTERM)

    def _take_signal(self, number: int) -> None:
        if number == signal.SIGHUP:
            self._renew_again = not self._stopping
        elif number in (signal.SIGTERM, signal.SIGINT):
            if self._stopping:
                for child in self._children.values():
                    child.kill_s = time.monotonic()
            else:
                self._tell("stopping", workers=len(self._children))
                self._stop()

    def _stop(self) -> None:
        self._stopping = True
        # Or those who come now would wait for nobody.
        self._listener.close()
        for child in self._children.values():
            self._end(child)

    def _reap(self) -> None:
        for child in list(self._children.values()):
            pid, status = os.waitpid(child.pid, os.WNOHANG)
            if pid:
                self._hear(child)
                os.close(child.news)
                del self._children[pid]
                self._forget(child.place)
                self._bury(child, os.waitstatus_to_exitcode(status))

    def _bury(self, child: _Child, code: int) -> None:
        """Decides what follows from a death. code: negative, a signal's number."""
        lane, now_s = child.lane, time.monotonic()
        lived_s = now_s - child.began_s
        who: dict[str, str | int | float | None] = {
            "worker": child.place,
            "pid": child.pid,
            "status": _SIGNAL_NAMES.get(-code, code),
            "lived_s": round(lived_s, 3),
            "error": child.trouble or None,
        }
        if child is lane.fresh:
            lane.fresh = None
            self._to_renew, self._renew_again = [], False
            self._tell("renewal_failed", **who)
            if lane.child is None and lane.due_s is None:
                lane.due_s = now_s + lane.backoff.died(lived_s)
        elif child is not lane.child or self._stopping:
            self._tell("worker_ended", **who)
        elif not self._was_ready:
            lane.child = None
            self._failure = child.trouble or f"a worker ended at start-up, status {who['status']}"
            self._stop()
        else:
            lane.child = None
            delay_s = lane.backoff.died(lived_s)
            # One that is on its way already takes the place.
            lane.due_s = None if lane.fresh else now_s + delay_s
            self._tell("worker_died", **who, restart_s=round(delay_s, 3))

    def _kill_what_is_late(self) -> None:
        now_s = time.monotonic()
        for child in self._children.values():
            if child.kill_s is not None and now_s >= child.kill_s:
                child.kill_s = None
                self._tell("worker_killed", worker=child.place, pid=child.pid)
                os.kill(child.pid, signal.SIGKILL)


@contextmanager
def _caught_signals() -> Iterator[socket.socket]:
    """A socket from which the numbers of the signals can be read that came to this process."""
    reader, writer = socket.socketpair()
    reader.setblocking(False)
    writer.setblocking(False)
    before = {number: signal.signal(number, lambda *_: None) for number in SIGNALS}
    wakeup = signal.set_wakeup_fd(writer.fileno(), warn_on_full_buffer=False)
    try:
        yield reader
    finally:
        signal.set_wakeup_fd(wakeup)
        for number, handler in before.items():
            signal.signal(number, handler)
        reader.close()
        writer.close()
