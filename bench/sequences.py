"""Bytes, errors and time of splat sequences as a stream, compared with one file for each frame.

Usage: scripts/bench sequences [--still-gs N] [--still-frames F] [--moving-gs N] [--frames F]
"""

from __future__ import annotations

import math
import os
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from codec.console import run_command
from codec.errors import InvalidError
from codec.interop.formats import SplatFormat, encode_splats, write_splats
from codec.sequence.importing import Imported, ImportOptions, import_stream
from codec.splats import Splats
from player.streamcommand import draw_poster
from tests.support.slots.rotating import figure, turned
from tests.support.trained_like import trained_like_splats

FPS = 30.0
TURN_RAD = math.radians(1)
"""Angle of the rotating figure per frame."""
SAMPLES = 3
"""Number of frames whose size is taken in the other formats; the sizes hardly differ."""

BESIDE = SplatFormat.PLY, SplatFormat.SPZ, SplatFormat.SOG
"""The formats to compare with, a file for each frame."""

Sequence = Callable[[int], Splats]
"""Generates the Gaussians of a frame."""


@dataclass(frozen=True, slots=True)
class SequencesConfig:
    """Imports synthetic sequences, and tabulates bytes, errors and time."""

    still_gs: int = 90_000
    """Gaussians of the still model."""
    still_frames: int = 300
    """Number of identical files of the still model."""
    moving_gs: int = 20_000
    """Gaussians of the moving sequences."""
    frames: int = 60
    """Files of a moving sequence."""

    def __post_init__(self) -> None:
        if min(self.still_gs, self.still_frames, self.moving_gs, self.frames) < 1:
            raise InvalidError("choose at least one Gaussian and one frame of each")


@dataclass(frozen=True, slots=True)
class Outcome:
    """Figures of one sequence."""

    made: Imported
    files_bytes: dict[SplatFormat, float]
    """Mean bytes of a frame as one file of each format."""
    seconds: float


def still(count: int) -> Sequence:
    splats = trained_like_splats(count)
    return lambda frame: splats


def rotating(count: int, is_shuffled: bool = False) -> Sequence:
    """A rigid figure that turns; is_shuffled: the Gaussians have a different order in each file."""
    splats = figure(count)

    def of(frame: int) -> Splats:
        frame_splats = turned(splats, TURN_RAD * frame)
        if not is_shuffled:
            return frame_splats
        return frame_splats.take(np.random.default_rng(frame).permutation(count))

    return of


def walking(count: int, is_noisy: bool = False) -> Sequence:
    """A fifth of the Gaussians moves one way, the rest stands still. is_noisy: adds noise to all,
    as if each frame had been trained from the previous one."""
    splats = trained_like_splats(count)
    walks = np.arange(count) < count // 5

    def of(frame: int) -> Splats:
        rng = np.random.default_rng(frame)
        means = splats.means + np.float32(0.01 * frame) * walks[:, None].astype(np.float32)
        if not is_noisy:
            return replace(splats, means=means)
        arrays = []
        sigmas = 1e-4, 0.01, 0.001, 0.01, 0.003
        for array, sigma in zip((means, *splats.arrays[1:]), sigmas, strict=True):
            arrays.append((array + rng.normal(0, sigma, array.shape)).astype(np.float32))
        return Splats(*arrays)

    return of


def measure(sequence: Sequence, num_frames: int, root: Path) -> Outcome:
    """Writes the files below `root` and imports them."""
    folder = root / "files"
    folder.mkdir()
    before, path = None, Path()
    for frame in range(num_frames):
        splats = sequence(frame)
        place = folder / f"frame_{frame:05d}.ply"
        if splats is before:
            os.link(path, place)
        else:
            write_splats(place, splats, SplatFormat.PLY)
        before, path = splats, place
    chosen = sorted({round(f) for f in np.linspace(0, num_frames - 1, SAMPLES)})
    files_bytes = {
        format: float(np.mean([len(encode_splats(sequence(frame), format)) for frame in chosen]))
        for format in BESIDE
    }
    start = time.perf_counter()
    import_stream(folder, root / "timed", ImportOptions(fps=FPS))
    seconds = time.perf_counter() - start
    made = import_stream(folder, root / "scored", ImportOptions(fps=FPS), draw_poster)
    return Outcome(made, files_bytes, seconds)


def table_of(outcomes: dict[str, Outcome]) -> Table:
    table = Table(box=box.MARKDOWN)
    table.add_column("sequence", no_wrap=True)
    table.add_column("bytes a frame", justify="right")
    table.add_column("first frame", justify="right")
    for format in BESIDE:
        table.add_column(f".{format}", justify="right")
    for name in ("on disk", "kept %", "moved %", "dB least", "position error", "ms a frame"):
        table.add_column(name, justify="right")
    for name, outcome in outcomes.items():
        made = outcome.made
        assert made.errors is not None
        total = max(sum(made.statuses), 1)
        kept, _, moved, _ = (100 * count / total for count in made.statuses)
        later = max(made.num_frames - 1, 1)
        table.add_row(
            name,
            f"{(made.played_bytes - made.first_bytes) / later:,.1f}",
            f"{made.first_bytes:,}",
            *(f"{size:,.0f}" for size in outcome.files_bytes.values()),
            f"{made.num_bytes:,}",
            f"{kept:.1f}",
            f"{moved:.1f}",
            f"{min(scores[-1] for scores in made.scores_db):.1f}",
            f"{1e3 * made.errors['position']:.2f} mm",
            f"{1e3 * outcome.seconds / made.num_frames:.0f}",
        )
    return table


def run(config: SequencesConfig) -> None:
    count, frames = config.moving_gs, config.frames
    cases: dict[str, tuple[Sequence, int]] = {
        f"still, {config.still_gs:,}": (still(config.still_gs), config.still_frames),
        f"rotating figure, {count:,}": (rotating(count), frames),
        "the same, in any order": (rotating(count, True), frames),
        f"a fifth walks, {count:,}": (walking(count), frames),
        "the same, noise in all": (walking(count, True), frames),
    }
    outcomes = {}
    for name, (sequence, num_frames) in cases.items():
        with tempfile.TemporaryDirectory() as root:
            outcomes[f"{name} x {num_frames}"] = measure(sequence, num_frames, Path(root))
    Console(width=190).print(table_of(outcomes))


if __name__ == "__main__":
    run_command(
        SequencesConfig, run, "scripts/bench sequences", "Measures imported sequences of splats."
    )
