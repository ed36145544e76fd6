"""Memory of the browser player while a clip loops: the heaps of the page and its workers.

Usage: scripts/bench loops [--minutes 30] [--rate 20]

A busy clip of 2 s loops from its buffer in headless Chromium. At each step playback pauses, garbage
is collected, and the JavaScript heaps of the page and of both workers are read, with their array
buffers. "a minute": slope of a straight line through all steps except the first, at which code is
still being compiled.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from bench.web.web import chromium_version
from codec.console import run_command
from codec.errors import InvalidError
from tests.support.slots.slot_streams import write_busy_stream
from tests.support.slots.updates import small_layout
from tests.support.web.chromium import running_chromium, why_not
from tests.support.web.heaps import PLAY_UNTIL, opened

FPS = 30
NUM_FRAMES = 60
SLOTS = (200, 200, 100)
SEGMENT_FRAMES = 15
BUFFER_MB = 64


@dataclass(frozen=True, slots=True)
class LoopsConfig:
    """Measures the browser player's memory while a clip loops."""

    minutes: float = 30.0
    """Length of playback, in minutes of the clip's own pace."""
    rate: float = 20.0
    """Playback rate as a share of that pace."""
    step_minutes: float = 3.0
    """Interval between two readings of memory, in minutes of the clip's own pace."""

    def __post_init__(self) -> None:
        if not 0 < 2 * self.step_minutes <= self.minutes or not self.rate > 0:
            raise InvalidError(
                f"--step-minutes is {self.step_minutes:g}, --rate {self.rate:g}; give positive "
                f"numbers, and at most half of --minutes ({self.minutes:g}) for a step"
            )


def heaps_of(config: LoopsConfig) -> tuple[list[float], list[list[int]]]:
    """(N) played minutes, and (N, 3) bytes in the heaps of the page and its workers."""
    minutes: list[float] = []
    heaps: list[list[int]] = []
    with tempfile.TemporaryDirectory() as name, running_chromium() as page:
        layout = small_layout(1, SLOTS, 0, SEGMENT_FRAMES)
        write_busy_stream(Path(name) / "stream", NUM_FRAMES, layout)
        with opened(page, Path(name), config.rate, BUFFER_MB) as playing:
            for step in range(1, round(config.minutes / config.step_minutes) + 1):
                frames = playing.run(PLAY_UNTIL, round(60 * FPS * config.step_minutes * step))
                minutes.append(frames / FPS / 60)
                heaps.append(playing.heaps_bytes())
    return minutes, heaps


def run(config: LoopsConfig) -> None:
    reason = why_not()
    if reason is not None:
        raise InvalidError(reason)
    minutes, heaps = heaps_of(config)
    names = "page kB", "worker kB", "worker kB"
    table = Table("minutes", *names, box=box.MARKDOWN)
    for at, sizes in zip(minutes, heaps, strict=True):
        table.add_row(f"{at:.1f}", *(f"{size / 1e3:,.0f}" for size in sizes))
    if len(minutes) > 2:
        slopes = np.polyfit(minutes[1:], np.array(heaps[1:]) / 1e3, 1)[0]
        table.add_row("a minute", *(f"{slope:+.2f}" for slope in slopes))
    print(f"{chromium_version()}; {config.rate:g} times the pace, {config.minutes:g} minutes of it")
    Console(width=100).print(table)


if __name__ == "__main__":
    run_command(LoopsConfig, run, "scripts/bench loops", "Measures the memory of a looping clip.")
