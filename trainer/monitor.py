"""What a person sees while a stream is trained."""

from __future__ import annotations

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from .fit import Progress as FitProgress
from .quality import QualityMeter


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
    """The progress bar, with the size of the stream and the quality of its newest frame."""

    def __init__(self, bar: Progress, num_frames: int, swin_size: int) -> None:
        self._bar = bar
        self._num_frames = num_frames
        self._swin_size = swin_size
        self._task = bar.add_task("genesis", total=None, score="")

    def on_progress(self, progress: FitProgress) -> None:
        last = min(progress.first_frame + self._swin_size, self._num_frames) - 1
        name = "genesis" if progress.first_frame == 0 else "window"
        self._bar.update(
            self._task,
            description=f"{name} {progress.first_frame}..{last} of {self._num_frames}",
            completed=progress.iteration,
            total=progress.iterations,
        )

    def on_slice(self, bytes_written: int, quality: QualityMeter) -> None:
        score = f"{bytes_written / 1e6:.2f} MB"
        if quality.last_db:
            score += f", {quality.last_db[-1]:.2f} dB"
        self._bar.update(self._task, score=score)
