"""swings-train of a folder of plain videos: a capture is made of them first, beside the stream."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from rich.console import Console

from codec.storage.openstorage import is_url
from trainer.capture.layout import plain_videos
from trainer.capture.video import VIDEOS_NAME
from trainer.errors import CaptureError

from .config import TrainConfig


def with_poses(config: TrainConfig, console: Console) -> TrainConfig:
    """The same config, or, where its capture is a folder of plain videos, one whose capture they
    have become, as `swings-capture calibrate` makes it. An earlier one of the same videos is used
    again. Raises CaptureError."""
    found = [] if is_url(config.capture) else plain_videos(Path(config.capture))
    if not found:
        return config
    videos = found[0].parent
    stream = str(config.target).rstrip("/")
    capture = Path(f"{stream.rpartition('/')[2] if is_url(stream) else stream}-capture")
    if capture.exists():
        _check_same(capture, videos)
    else:
        from trainer.calibrate.capturecommand import Calibrate
        from trainer.calibrate.command import calibrate  # it draws, and matplotlib loads slowly

        report = calibrate(Calibrate((videos, capture)), console)
        console.print(report, highlight=False, markup=False, soft_wrap=True)
    console.print(
        f"poses: {capture}; remove it to have them found again",
        highlight=False, markup=False, soft_wrap=True,
    )  # fmt: skip
    return replace(config, capture=capture, title=config.title or videos.resolve().name)


def _check_same(capture: Path, videos: Path) -> None:
    for made in (capture / VIDEOS_NAME).glob("*"):
        of = videos / made.name
        if not of.is_file() or of.stat().st_size != made.stat().st_size:
            raise CaptureError(
                f"{capture}: a capture of other videos than those in {videos}; remove it, or name "
                "another stream"
            )
