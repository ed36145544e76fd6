"""Progress line and log while a stream is trained."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

from codec.progressline import ProgressLine, clock
from trainer.fit.config import FitConfig
from trainer.fit.observer import Observer
from trainer.fit.observer import Progress as FitProgress
from trainer.score.meter import QualityMeter

from .runlog import RunLog
from .runstatus import RunStatus


@dataclass(frozen=True, slots=True)
class _Mark:
    """A moment, to take rates from."""

    time_s: float
    iterations: int


LONG_S = 3600.0
"""Estimated time of a run from which on a line says how to shorten it."""

SURE_S = 30.0
"""Time after which the estimate is good enough for that."""


class Monitor(Observer):
    """Shows all iterations of the run on a progress line, and logs every finished frame."""

    def __init__(
        self,
        line: ProgressLine,
        log: RunLog,
        config: FitConfig,
        num_frames: int,
        now_s: Callable[[], float] = time.monotonic,
        size_px: tuple[int, int] = (0, 0),
    ) -> None:
        """size_px: width and height of the largest training pictures."""
        self._line, self._log, self._config, self._now_s = line, log, config, now_s
        self._size_px, self._is_long = size_px, False
        self._num_frames = num_frames
        self._total = self._before(num_frames)
        self._loss = 0.0
        self._has_begun = False
        self._begin = self._last = _Mark(now_s(), 0)
        self._status = RunStatus(0, num_frames, 0.0, 0.0, None)

    def _before(self, window: int) -> int:
        """Iterations of the windows before `window`."""
        if window == 0:
            return 0
        return self._config.iterations(0) + (window - 1) * self._config.iterations(1)

    def window_begun(self, first_frame: int, done: int) -> None:
        if not self._has_begun:  # what a resumed run has behind it took none of its time
            self._has_begun = True
            self._begin = self._last = _Mark(self._now_s(), self._before(first_frame) + done)
        self._tell(first_frame, self._before(first_frame) + done)

    def progressed(self, progress: FitProgress) -> None:
        self._loss = progress.loss
        self._tell(progress.first_frame, self._before(progress.first_frame) + progress.iteration)

    def _tell(self, frame: int, iterations: int) -> None:
        elapsed_s = self._now_s() - self._begin.time_s
        done = iterations - self._begin.iterations
        self._status = replace(
            self._status,
            frame=frame,
            share=iterations / self._total,
            elapsed_s=elapsed_s,
            left_s=elapsed_s / done * (self._total - iterations) if done else None,
        )
        self._line.show(self._status.stage())
        whole_s = elapsed_s + (self._status.left_s or 0)
        if not self._is_long and elapsed_s > SURE_S and whole_s > LONG_S:
            self._is_long = True
            width_px, height_px = self._size_px
            self._line.say(
                f"at {width_px}x{height_px} pixels this takes about {clock(whole_s)}; "
                f"--longest-px {max(self._size_px) // 2} takes about a quarter"
            )

    def frame_finished(
        self, frame: int, gaussians: int, played_bytes: int, meter: QualityMeter
    ) -> None:
        """`gaussians` show in the frame; the stream takes `played_bytes` so far, 0 until the first
        segment is on disk."""
        now = _Mark(self._now_s(), self._before(frame + 1))
        rate = (now.iterations - self._last.iterations) / max(now.time_s - self._last.time_s, 1e-9)
        self._last = now
        self._status = replace(
            self._status,
            psnr_db=meter.mean_db,
            bytes_per_frame=played_bytes / (frame + 1) if played_bytes else None,
            iterations_per_s=rate,
        )
        self._tell(frame, now.iterations)
        self._log.add(
            self._status.log_row()
            | {
                "iterations_per_s": round(rate, 2),
                "loss": round(self._loss, 6),
                "gaussians": gaussians,
            }
        )
