"""How far a training run is: a progress line, and a log of one JSON object per line and, if wanted,
TensorBoard scalars.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from codec.errors import InvalidError
from codec.files import append_durably, opened_regular
from codec.progressline import ProgressLine, Stage, clock
from trainer.fit.config import FitConfig
from trainer.fit.observer import Observer
from trainer.fit.observer import Progress as FitProgress
from trainer.score.meter import QualityMeter


@dataclass(frozen=True, slots=True)
class RunStatus:
    """A run at a moment."""

    frame: int
    """The frame that the running window begins with."""
    num_frames: int
    share: float
    """Finished share of all iterations, 0 to 1."""
    elapsed_s: float
    left_s: float | None
    """None until an iteration was timed."""
    psnr_db: float | None = None
    """Mean over the held-out cameras; None before the first frame is finished."""
    bytes_per_frame: float | None = None
    """Mean size of the frames in the stream; None before its first segment is on disk."""
    iterations_per_s: float | None = None

    def stage(self) -> Stage:
        """Text of the progress line."""
        frame, total = self.frame, self.num_frames
        figures = (
            (self.psnr_db, "{:.2f} dB", 1.0),
            (self.bytes_per_frame, "{:.1f} kB/frame", 1e3),
            (self.iterations_per_s, "{:.0f} it/s", 1.0),
        )
        return Stage(
            f"frame {frame} of {total}" if frame else f"first of {total} frames",
            self.share,
            self.elapsed_s,
            self.left_s,
            tuple(text.format(value / unit) for value, text, unit in figures if value is not None),
        )

    def log_row(self) -> dict[str, float | None]:
        """Entry of the log, once `frame` is finished."""
        left_s, psnr_db = self.left_s, self.psnr_db
        return {
            "frame": self.frame,
            "time_s": round(self.elapsed_s, 3),
            "left_s": None if left_s is None else round(left_s, 1),
            "psnr_db": None if psnr_db is None else round(psnr_db, 3),
            "bytes_per_frame": round(self.bytes_per_frame or 0),
        }


LOG_NAME = "training.jsonl"
"""The log's file name in a stream's folder, unless another is named."""


def _tensorboard(folder: Path) -> Any:
    try:
        from tensorboardX import SummaryWriter
    except ImportError as error:
        raise InvalidError(
            "--tensorboard needs the package tensorboardX: pip install '.[tensorboard]'"
        ) from error
    return SummaryWriter(str(folder))


def _whole_lines_bytes(path: Path) -> int:
    """Size of what is at `path` up to the end of its last line: a machine that stopped may have
    left a part of one."""
    if not path.exists():
        return 0
    with opened_regular(path) as file:
        return file.read().rfind(b"\n") + 1


class RunLog:
    """Appends records; a resumed run goes on in the same file. Every line is whole, also when the
    process dies or the disk is full."""

    def __init__(self, path: Path, tensorboard: Path | None = None) -> None:
        """Opens nothing before the first record, so that a refused run leaves no file. Raises
        InvalidError when TensorBoard is wanted and not installed."""
        self._path = path
        self._size_bytes: int | None = None
        self._scalars = _tensorboard(tensorboard) if tensorboard is not None else None

    def add(self, record: dict[str, Any]) -> None:
        """Writes `record`, which has the key "frame"; its numbers become scalars at that frame."""
        if self._size_bytes is None:
            self._size_bytes = _whole_lines_bytes(self._path)
        line = json.dumps(record).encode() + b"\n"
        append_durably(self._path, self._size_bytes, line)
        self._size_bytes += len(line)
        if self._scalars is not None:
            for name, value in record.items():
                if isinstance(value, int | float) and name != "frame":
                    self._scalars.add_scalar(name, value, record["frame"])

    def __enter__(self) -> RunLog:
        return self

    def __exit__(self, *_: object) -> None:
        if self._scalars is not None:
            self._scalars.close()


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
