"""What a person sees while a stream is trained, and what the log keeps of it."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from trainer.fit.config import FitConfig
from trainer.fit.trainer import Observer
from trainer.fit.trainer import Progress as FitProgress
from trainer.score.meter import QualityMeter

from .runlog import RunLog


def progress_bar(console: Console) -> Progress:
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(bar_width=20),
        TextColumn("{task.percentage:.0f} %"),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(elapsed_when_finished=True),
        TextColumn("{task.fields[score]}"),
        console=console,
    )


@dataclass(frozen=True, slots=True)
class _Mark:
    """A moment, to take rates from."""

    time_s: float
    iterations: int


class Monitor(Observer):
    """The progress bar over all iterations of the run, and one record per finished frame."""

    def __init__(
        self,
        bar: Progress,
        log: RunLog,
        config: FitConfig,
        num_frames: int,
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._bar, self._log, self._config, self._now_s = bar, log, config, now_s
        self._num_frames = num_frames
        self._total = self._before(num_frames)
        self._loss = 0.0
        self._has_begun = False
        self._begin = self._last = _Mark(now_s(), 0)
        self._task = bar.add_task("genesis", start=False, total=self._total, score="")

    def _before(self, window: int) -> int:
        """Iterations of the windows before `window`."""
        if window == 0:
            return 0
        return self._config.iterations(0) + (window - 1) * self._config.iterations(1)

    def window_begun(self, first_frame: int) -> None:
        if not self._has_begun:  # what a resumed run has behind it took none of its time
            self._has_begun = True
            self._begin = self._last = _Mark(self._now_s(), self._before(first_frame))
            self._bar.reset(self._task, completed=self._begin.iterations)

    def progressed(self, progress: FitProgress) -> None:
        last = min(progress.first_frame + self._config.swin_size, self._num_frames) - 1
        name = "genesis" if progress.first_frame == 0 else "frames"
        self._loss = progress.loss
        self._bar.update(
            self._task,
            description=f"{name} {progress.first_frame}..{last} of {self._num_frames}",
            completed=self._before(progress.first_frame) + progress.iteration,
        )

    def frame_finished(
        self, frame: int, gaussians: int, played_bytes: int, meter: QualityMeter
    ) -> None:
        """`gaussians` show in the frame; the stream takes `played_bytes` so far, 0 until the first
        segment is on disk."""
        now = _Mark(self._now_s(), self._before(frame + 1))
        rate = (now.iterations - self._last.iterations) / max(now.time_s - self._last.time_s, 1e-9)
        pace_s = (now.time_s - self._begin.time_s) / (now.iterations - self._begin.iterations)
        self._last = now
        psnr_db = meter.last_db[-1] if meter.last_db else None
        bytes_per_frame = played_bytes / (frame + 1)
        self._log.add(
            {
                "frame": frame,
                "time_s": round(now.time_s - self._begin.time_s, 3),
                "left_s": round(pace_s * (self._total - now.iterations), 1),
                "iterations_per_s": round(rate, 2),
                "loss": round(self._loss, 6),
                "gaussians": gaussians,
                "psnr_db": None if psnr_db is None else round(psnr_db, 3),
                "bytes_per_frame": round(bytes_per_frame),
            }
        )
        score = f"{rate:.1f} it/s, {gaussians:,} Gaussians"
        if psnr_db is not None:
            score += f", {psnr_db:.2f} dB"
        if played_bytes:
            score += f", {bytes_per_frame / 1e3:.1f} kB/frame"
        self._bar.update(self._task, score=score)
