"""What a person sees while a stream is trained: progress, and the score of every final frame."""

from __future__ import annotations

from collections import deque

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from codec.manifest import Manifest
from codec.slice import Slice
from codec.splats import Splats

from .capture.capture import Capture
from .evaluate import score_picture
from .fit import Progress as FitProgress
from .frames import FrameCache


def progress_bar(console: Console) -> Progress:
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.completed} it"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[score]}"),
        console=console,
    )


class Monitor:
    """The progress bar, and the held-out score of every frame that is final."""

    def __init__(
        self, bar: Progress, capture: Capture, cache: FrameCache, manifest: Manifest
    ) -> None:
        self._bar, self._capture, self._cache = bar, capture, cache
        self._near_m = manifest.near_m
        self._swin_size = manifest.swin_size
        self._window: deque[Slice] = deque(maxlen=manifest.swin_size)
        self._task = bar.add_task("genesis", total=None, score="")

    def on_progress(self, progress: FitProgress) -> None:
        last = min(progress.first_frame + self._swin_size, len(self._cache.frames)) - 1
        name = "genesis" if progress.first_frame == 0 else "window"
        self._bar.update(
            self._task,
            description=f"{name} {progress.first_frame}..{last} of {len(self._cache.frames)}",
            completed=progress.iteration,
            total=progress.iterations,
        )

    def on_slice(self, part: Slice, bytes_written: int) -> None:
        self._window.append(part)
        if part.birth < 0:
            return
        score = f"{bytes_written / 1e6:.2f} MB"
        if self._capture.held_out:
            index = self._capture.held_out[part.birth % len(self._capture.held_out)]
            shown = [
                s.splats.take(np.flatnonzero(s.active(part.birth, self._swin_size)))
                for s in self._window
            ]
            got = score_picture(
                Splats.concatenate(shown),
                self._cache.camera(index),
                self._cache.image(index, self._cache.frames[part.birth]),
                self._near_m,
            )
            score += f", held-out {got.psnr_db:.2f} dB"
        self._bar.update(self._task, score=score)
