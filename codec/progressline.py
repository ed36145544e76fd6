"""How far a command is: a bar and one line that fits the terminal, plain lines where there is
none."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Protocol, Self

from rich.console import Console
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

LINE_COLUMNS = 80
"""Width of a plain line."""

BAR_COLUMNS = 10
"""The bar is one, two or three times as wide, as the line leaves room for it."""


@dataclass(frozen=True, slots=True)
class Stage:
    """How far a command is at a moment."""

    what: str
    """The work, or its current step."""
    share: float | None
    """Completed share of the work, 0 to 1; None while its amount is unknown."""
    elapsed_s: float
    left_s: float | None
    """None until it can be estimated."""
    figures: tuple[str, ...] = ()
    """The last results, most important first."""


def clock(time_s: float) -> str:
    """`time_s` as 4:05 or 1:04:05."""
    minutes, seconds = divmod(max(0, round(time_s)), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{seconds:02}" if hours else f"{minutes}:{seconds:02}"


def line_of(stage: Stage, columns: int) -> str:
    """A stage in a line, at most `columns` wide: where that is too narrow for all, the last parts
    are left out."""
    left = "" if stage.left_s is None else f", {clock(stage.left_s)} left"
    parts = [] if stage.share is None else [f"{stage.share:.0%} done"]
    parts += [f"{clock(stage.elapsed_s)} elapsed{left}", *stage.figures]
    line = stage.what
    for part in parts:
        if len(line) + 2 + len(part) > columns:
            break
        line += f"  {part}"
    return line[:columns]


@contextmanager
def waiting(console: Console, text: str) -> Iterator[None]:
    """Shows `text` while the block runs: in place on a terminal, else as a line of its own, so that
    a log shows what takes so long. Nothing for an empty text."""
    if console.is_terminal:
        with console.status(text):
            yield
        return
    if text:
        console.print(text, highlight=False, markup=False, soft_wrap=True)
    yield


class ProgressLine:
    """The line of a command, from `with` to its end: drawn in place on a terminal, else written as
    a new line every `every_s` and at the end. Any thread may show a stage."""

    def __init__(
        self,
        console: Console,
        now_s: Callable[[], float] = time.monotonic,
        every_s: float = 30.0,
        first_s: float = 0.0,
    ) -> None:
        """first_s: a command that ends before writes no line where there is no terminal."""
        self._console, self._now_s, self._every_s = console, now_s, every_s
        self._stage: Stage | None = None
        self._written: Stage | None = None
        self._due_s = now_s() + first_s
        self._lock = threading.Lock()
        self._live = (
            Live(
                get_renderable=self._drawn,
                console=console,
                refresh_per_second=4,
                redirect_stdout=False,  # what Ray prints there is taken care of
            )
            if console.is_terminal
            else None
        )

    def show(self, stage: Stage) -> None:
        self._stage = stage
        if self._live is None and self._now_s() >= self._due_s:
            self._write()

    def say(self, text: str) -> None:
        """Writes a line that stays, above that of the stage."""
        self._console.print(text, highlight=False, markup=False, soft_wrap=True)

    def _drawn(self) -> Table:
        grid = Table.grid(padding=(0, 1, 0, 0))
        if (stage := self._stage) is not None:
            # A line as wide as the terminal would begin the next one.
            columns = max(1, self._console.width - 1)
            line = line_of(stage, columns)
            bars = min(3, (columns - len(line) - 1) // BAR_COLUMNS)
            text = Text(line, no_wrap=True, overflow="crop")
            if stage.share is None or bars < 1:
                grid.add_row(text)
            else:
                grid.add_row(ProgressBar(1.0, stage.share, bars * BAR_COLUMNS), text)
        return grid

    def _write(self) -> None:
        with self._lock:
            stage = self._stage
            if stage is None or stage == self._written:
                return
            self._written, self._due_s = stage, self._now_s() + self._every_s
            self._console.out(line_of(stage, LINE_COLUMNS), highlight=False)
            self._console.file.flush()

    def __enter__(self) -> Self:
        if self._live is not None:
            self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._live is not None:
            self._live.stop()
        elif self._written is not None:
            self._write()


class Counter(Protocol):
    """Shows how far a command is."""

    def __call__(self, done: int, total: int | None, what: str | None = None, /) -> None:
        """done, total: the number of steps that are done, and of all; None if that is not known.
        what: what was done last, in place of these numbers."""


@contextmanager
def counted(
    what: str, console: Console | None = None, now_s: Callable[[], float] = time.monotonic
) -> Iterator[Counter]:
    """Shows how far `what` is, by the counter that it gives.

    Without a terminal, steps that take less than ten seconds together write no line. console:
    standard error if None.
    """
    begin_s = now_s()
    with ProgressLine(console or Console(stderr=True), now_s, every_s=10, first_s=10) as line:

        def show(done: int, total: int | None, last: str | None = None) -> None:
            elapsed_s = now_s() - begin_s
            if total is None:
                line.show(Stage(what, None, elapsed_s, None, (last or f"{done}",)))
                return
            left_s = elapsed_s / done * (total - done) if done else None
            share = done / total if total else 1.0
            line.show(Stage(what, share, elapsed_s, left_s, (last or f"{done} of {total}",)))

        yield show
