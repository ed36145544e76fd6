"""One process more: forked before any thread, bound to its parent's life, heard through a pipe."""

from __future__ import annotations

import ctypes
import logging
import os
import random
import signal
import sys
import threading
from collections.abc import Callable, Sequence

from codec.errors import SwingsError

log = logging.getLogger(__name__)

READY = b"\0"
"""Said once by a process that is ready. Anything else says why it has ended."""

MAX_TROUBLE_BYTES = 4000

BUG_STATUS = 70

_PR_SET_PDEATHSIG = 1


def fork_worker(
    work: Callable[[Callable[[], None]], None], signals: Sequence[signal.Signals]
) -> tuple[int, int]:
    """Starts a process that does `work` and ends; gives its pid, and a pipe of what it says.

    work: is given a function to call when it is ready. signals: those that the parent handles; the
    child gets SIGTERM as processes get it, and no SIGINT or SIGHUP, which terminals send to all.
    When the parent dies it gets a SIGTERM.
    """
    if not sys.platform.startswith("linux"):
        raise SwingsError("several workers need Linux; use one worker, without a supervisor")
    if threading.active_count() > 1:
        raise RuntimeError("a process with threads cannot be forked safely")
    # The first call compiles nothing and loads nothing in the child.
    prctl = ctypes.CDLL(None, use_errno=True).prctl
    parent = os.getpid()
    reader, writer = os.pipe()
    os.set_blocking(reader, False)
    sys.stdout.flush()
    sys.stderr.flush()
    # A signal in between would be taken by the parent's handlers in the child.
    before = signal.pthread_sigmask(signal.SIG_BLOCK, signals)
    try:
        pid = os.fork()
    except OSError:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        os.close(reader)
        os.close(writer)
        raise
    if pid:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        os.close(writer)
        return pid, reader
    status = BUG_STATUS
    try:
        signal.set_wakeup_fd(-1)
        for number in signals:
            ignored = number in (signal.SIGINT, signal.SIGHUP)
            signal.signal(number, signal.SIG_IGN if ignored else signal.SIG_DFL)
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        os.close(reader)
        if prctl(_PR_SET_PDEATHSIG, signal.SIGTERM) or os.getppid() != parent:
            os._exit(0)
        random.seed()  # or all workers would draw the same numbers
        status = _do(work, writer)
    finally:
        # Nothing above this frame may go on in the child: it is the parent's.
        os._exit(status)


def _do(work: Callable[[Callable[[], None]], None], writer: int) -> int:
    def ready() -> None:
        os.write(writer, READY)

    status = 0
    try:
        work(ready)
    except (SwingsError, OSError) as error:
        message = " ".join(str(error).split()) or type(error).__name__
        os.write(writer, message.encode(errors="replace")[:MAX_TROUBLE_BYTES])
        status = 1
    except SystemExit as error:
        status = error.code if isinstance(error.code, int) else 1
    except BaseException:
        log.exception("internal error in a worker")
        status = BUG_STATUS
    sys.stdout.flush()
    sys.stderr.flush()
    return status
