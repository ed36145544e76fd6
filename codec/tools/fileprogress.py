"""How far an import is: a bar where somebody looks at it, else a line now and then."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

LINE_EVERY_S = 10.0
"""Seconds between lines that are written where no terminal is."""


@contextmanager
def told(
    what: str, now_s: Callable[[], float] = time.monotonic
) -> Iterator[Callable[[int, int], None]]:
    """Gives a function that is told how many steps of how many are done; writes to stderr."""
    if not sys.stderr.isatty():
        yield _lines(what, now_s)
        return
    columns = TextColumn("{task.description}"), BarColumn(30), TextColumn("{task.percentage:.0f} %")
    bar = Progress(
        *columns, TextColumn("left"), TimeRemainingColumn(), console=Console(stderr=True)
    )
    with bar:
        task = bar.add_task(what)
        yield lambda done, total: bar.update(task, completed=done, total=total)


def _lines(what: str, now_s: Callable[[], float]) -> Callable[[int, int], None]:
    """A function that writes a line if the last one, or the beginning, is LINE_EVERY_S ago."""
    began_s = last_s = now_s()

    def tell(done: int, total: int) -> None:
        nonlocal last_s
        if now_s() - last_s >= LINE_EVERY_S:
            last_s = now_s()
            left = ""
            if 0 < done < total:
                left = f", {_duration((last_s - began_s) / done * (total - done))} left"
            sys.stderr.write(f"{what}: {100 * done // total} %{left}\n")

    return tell


def _duration(duration_s: float) -> str:
    """Two digits or so, for people."""
    return f"{duration_s:.0f} s" if duration_s < 120 else f"{duration_s / 60:.0f} min"
