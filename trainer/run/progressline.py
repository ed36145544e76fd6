"""How far a training run is: one line that fits the terminal, plain lines where there is none."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import TracebackType
from typing import Self

from rich.console import Console
from rich.live import Live
from rich.text import Text

TELL_EVERY_S = 30.0
"""Between two lines where nobody looks at a terminal."""

LINE_COLUMNS = 80
"""Of a plain line."""


@dataclass(frozen=True, slots=True)
class Standing:
    """Of a run, at a moment."""

    frame: int
    """The frame that the running window begins with."""
    num_frames: int
    share: float
    """Of all iterations, what is done: 0 to 1."""
    gone_s: float
    left_s: float | None
    """None until an iteration was timed."""
    psnr_db: float | None = None
    """Mean over the held-out cameras; None before the first frame is finished."""
    bytes_per_frame: float | None = None
    """Of the stream so far; None before its first segment is on disk."""
    iterations_per_s: float | None = None


def clock(time_s: float) -> str:
    """`time_s` as 4:05 or 1:04:05."""
    minutes, seconds = divmod(max(0, round(time_s)), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{seconds:02}" if hours else f"{minutes}:{seconds:02}"


def line_of(standing: Standing, columns: int) -> str:
    """What a person wants to know of a run, at most `columns` wide: where that is too narrow for
    all, the last parts are left out."""
    s = standing
    parts = [
        f"frame {s.frame} of {s.num_frames}" if s.frame else f"first of {s.num_frames} frames",
        f"{s.share:.0%} done",
        f"{clock(s.gone_s)} elapsed" + ("" if s.left_s is None else f", {clock(s.left_s)} left"),
    ]
    if s.psnr_db is not None:
        parts.append(f"{s.psnr_db:.2f} dB")
    if s.bytes_per_frame is not None:
        parts.append(f"{s.bytes_per_frame / 1e3:.1f} kB/frame")
    if s.iterations_per_s is not None:
        parts.append(f"{s.iterations_per_s:.0f} it/s")
    line = parts[0]
    for part in parts[1:]:
        if len(line) + 2 + len(part) > columns:
            break
        line += f"  {part}"
    return line[:columns]


@contextmanager
def waiting(console: Console, text: str) -> Iterator[None]:
    """Shows `text` while the block runs: in place on a terminal, else as a line of its own, so that
    a log tells what takes so long. Nothing for an empty text."""
    if console.is_terminal:
        with console.status(text):
            yield
        return
    if text:
        console.print(text, highlight=False, markup=False, soft_wrap=True)
    yield


class ProgressLine:
    """The line of a run, from `with` to its end: drawn in place on a terminal, else written as a
    new line every TELL_EVERY_S and at the end. Any thread may tell."""

    def __init__(self, console: Console, now_s: Callable[[], float] = time.monotonic) -> None:
        self._console, self._now_s = console, now_s
        self._standing: Standing | None = None
        self._written: Standing | None = None
        self._due_s = now_s()
        self._lock = threading.Lock()
        self._live = (
            Live(
                get_renderable=self._text,
                console=console,
                refresh_per_second=4,
                redirect_stdout=False,  # what Ray prints there is taken care of
            )
            if console.is_terminal
            else None
        )

    def tell(self, standing: Standing) -> None:
        self._standing = standing
        if self._live is None and self._now_s() >= self._due_s:
            self._write()

    def _text(self) -> Text:
        told = self._standing
        # A line as wide as the terminal would begin the next one.
        line = "" if told is None else line_of(told, max(1, self._console.width - 1))
        return Text(line, no_wrap=True, overflow="crop")

    def _write(self) -> None:
        with self._lock:
            told = self._standing
            if told is None or told == self._written:
                return
            self._written, self._due_s = told, self._now_s() + TELL_EVERY_S
            self._console.out(line_of(told, LINE_COLUMNS), highlight=False)
            self._console.file.flush()

    def __enter__(self) -> Self:
        if self._live is not None:
            self._live.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._live is not None:
            self._live.stop()
        else:
            self._write()
