"""One worker: a process forked by gunicorn's arbiter, with an event loop that sends a heartbeat."""

from __future__ import annotations

import asyncio
import logging
import mmap
import os
import random
import signal
import socket
import time
import traceback
from types import FrameType
from typing import TYPE_CHECKING, Any

from gunicorn.workers.base import Worker

from codec.errors import SwingsError

if TYPE_CHECKING:
    from .arbiter import WorkerApplication

log = logging.getLogger(__name__)

BEAT_S = 0.5
"""Seconds between two heartbeats."""

MAX_FAILURE_BYTES = 4000

BUG_STATUS = 70

HANG_FRAMES = 5
"""Innermost frames of a hanging event loop that are logged."""


class StreamWorker(Worker):
    """Runs `WorkerHooks.serve` on an event loop.

    Not aiohttp's GunicornWebWorker: it leaves accepting connections to asyncio, which knows no
    limits per address.
    """

    app: WorkerApplication

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.number = 0
        """From 0 to 2 * workers - 1: no two living workers have the same. During a renewal there
        are up to twice as many workers as usual."""
        # gunicorn's own class around the socket, which its type stubs leave out.
        self.listener: socket.socket = self.sockets[0].sock  # type: ignore[attr-defined]
        """The listening socket, shared by all workers."""
        self.began_s = time.monotonic()
        self.kill_s: float | None = None
        """When it is killed; set when the arbiter asks it to end."""
        # Shared with the process to be forked: one byte for ready, then why it failed.
        self._report = mmap.mmap(-1, 1 + MAX_FAILURE_BYTES)

    @property
    def is_ready(self) -> bool:
        return bool(self._report[0])

    @property
    def failure(self) -> str:
        """Why it could not serve; empty if it did not say."""
        return self._report[1:].rstrip(b"\0").decode(errors="replace")

    def init_process(self) -> None:
        """Serves until SIGTERM, and ends the process."""
        status = BUG_STATUS
        try:
            self.init_signals()
            random.seed()  # or all workers would draw the same numbers
            asyncio.run(self.app.hooks.serve(self))
            status = 0
        except (SwingsError, OSError) as error:
            message = " ".join(str(error).split()) or type(error).__name__
            failure = message.encode(errors="replace")[:MAX_FAILURE_BYTES]
            self._report[1 : 1 + len(failure)] = failure
            status = 0  # the arbiter reports it; for other codes gunicorn logs a line of its own
        except BaseException:
            log.exception("internal error in a worker")
        finally:
            # The frames above this one belong to the arbiter and must not run on in the worker.
            os._exit(status)

    def init_signals(self) -> None:
        for number in (signal.SIGTERM, signal.SIGCHLD):
            signal.signal(number, signal.SIG_DFL)
        # A terminal sends these to all processes; the arbiter acts on them.
        for number in (signal.SIGINT, signal.SIGHUP):
            signal.signal(number, signal.SIG_IGN)
        signal.signal(signal.SIGQUIT, lambda *_: os._exit(0))
        signal.signal(signal.SIGABRT, self.handle_abort)
        signal.pthread_sigmask(signal.SIG_SETMASK, ())

    def handle_abort(self, sig: int, frame: FrameType | None) -> None:
        """Logs where the event loop hangs. gunicorn sends SIGABRT a second before SIGKILL."""
        stack = traceback.extract_stack(frame)[: -HANG_FRAMES - 1 : -1]
        where = ", ".join(f"{os.path.basename(f.filename)}:{f.lineno} {f.name}" for f in stack)
        log.critical("the event loop hangs in %s", where)
        time.sleep(0.2)  # for the thread that writes the log
        os._exit(BUG_STATUS)

    def ready(self) -> None:
        """Must be called once, on the event loop, when the worker accepts connections."""
        self.app.event("worker_ready", worker=self.number, pid=os.getpid())
        self._report[0] = 1
        # The first heartbeat. gunicorn watches a worker from then on; starting may take longer.
        if self._beat():
            os.kill(self.ppid, signal.SIGCHLD)  # so that the arbiter looks at once

    def _beat(self) -> bool:
        """Sends heartbeats from now on; ends the worker, and is False, without its arbiter."""
        if os.getppid() != self.ppid:
            os.kill(os.getpid(), signal.SIGTERM)
            return False
        self.notify()
        asyncio.get_running_loop().call_later(BEAT_S, self._beat)
        return True
