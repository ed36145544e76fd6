"""Signals that end a command, kept waiting where an exception would do harm."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

NUMBERS = [
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)
]


@contextmanager
def postponed_interrupts() -> Iterator[None]:
    """Lets the handler of a signal that comes in the block run after the block; a second signal is
    not postponed. Outside the main thread it does nothing.

    Use it where threads start: an exception in `Thread.start` leaves a thread that its pool does
    not know and does not wait for, or becomes a RuntimeError of the lock in it.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[int] = []
    handlers = {n: found for n in NUMBERS if callable(found := signal.getsignal(n))}

    def postpone(number: int, frame: FrameType | None) -> None:
        came.append(number)
        if len(came) > 1:
            handlers[signal.Signals(number)](number, frame)

    try:
        for number in handlers:
            signal.signal(number, postpone)
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
        if len(came) == 1:  # of two, the second has had its way
            signal.raise_signal(came[0])
