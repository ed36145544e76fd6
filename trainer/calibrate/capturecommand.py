"""swings-capture: its subcommands and their options."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from codec.console import say

from .rigimport import Import, import_calibration


@dataclass(frozen=True)
class Calibrate:
    """Makes a capture of videos alone: synchronises them and finds where their cameras stood."""

    videos: tyro.conf.Positional[
        Annotated[tuple[Path, ...], tyro.conf.arg(metavar="VIDEOS... CAPTURE")]
    ]
    """A video or a folder of numbered pictures for each camera, or one folder with either; and last
    the folder to make."""
    without_cameras: tuple[str, ...] = ()
    """Cameras to leave out, by name: those of their videos or folders."""
    metres: tuple[str, str, float] | None = None
    """Two cameras and their distance, metres, for the unit of the capture."""
    offsets: Path | None = None
    """File with a line for each camera: its name, and the time in its video, seconds, of a moment
    that all show. Without it, sound, timecode, a flash or movement tell."""
    moments: int | None = None
    """Number of moments of which the rig is made. More take longer and are more precise. By default
    16 to 60, such that all cameras have some 640 pictures."""
    longest_px: int = 1600
    """Longer side of the pictures in which features are sought; larger ones are scaled down."""
    features: int = 4096
    """Most features of a picture."""
    threads: int = field(default_factory=lambda: os.cpu_count() or 1)
    """Number of threads."""


@dataclass(frozen=True, slots=True)
class CaptureCommand:
    """Which subcommand to run."""

    action: Annotated[Calibrate | Import, tyro.conf.arg(name="")]


def run_capture(command: CaptureCommand) -> None:
    match command.action:
        case Calibrate() as config:
            from .command import calibrate  # it draws, and matplotlib loads slowly

            say(calibrate(config))
        case Import() as config:
            say(import_calibration(config))
