"""Import of a long sequence whose files have no common order, like those of a deformation network:
bytes per frame, PSNR with all harmonics, memory and time.

Usage: scripts/bench shuffled [--gaussians N] [--frames F] [--sh-degree D] [--files FOLDER]
"""

from __future__ import annotations

import os
import subprocess
import tempfile
import time
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from codec.console import run_command
from codec.errors import InvalidError, SwingsError
from codec.interop.formats import SplatFormat, write_splats
from codec.stream.reader import StreamReader
from tests.support.commands import command, environment
from tests.support.deforming import FPS, Deforming


@dataclass(frozen=True, slots=True)
class ShuffledConfig:
    """Imports a sequence with motion, jitter, births and deaths, and tabulates its cost."""

    gaussians: int = 50_000
    """Maximum number of Gaussians in a frame."""
    frames: int = 300
    """Number of files of the sequence."""
    sh_degree: int = 3
    """Degree of the spherical harmonics."""
    files: Path | None = None
    """Folder to keep the files in; existing files are used unchanged."""

    def __post_init__(self) -> None:
        if min(self.gaussians, self.frames) < 1:
            raise InvalidError("choose at least one Gaussian and one frame")


def write_files(config: ShuffledConfig, folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    if any(folder.iterdir()):
        return
    deforming = Deforming(config.gaussians, config.sh_degree)
    for frame in range(config.frames):
        write_splats(folder / f"frame_{frame:05d}.ply", deforming.next(), SplatFormat.PLY)


def run(config: ShuffledConfig) -> None:
    with ExitStack() as stack:
        made = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        folder, stream = config.files or made / "files", made / "stream"
        write_files(config, folder)
        begin_s = time.monotonic()
        words = command("swings-stream", "import", folder, stream, "--fps", f"{FPS:g}")
        process = subprocess.Popen(words, env=environment())
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)  # wait4 has waited for it
        if status:
            raise SwingsError(f"the import ended with {process.returncode}")
        wall_s = time.monotonic() - begin_s
        reader = StreamReader(stream)
        records = reader.records
        played_bytes = sum(record.played_bytes for record in records)
        scores_db = np.array([record.psnr_db[-1] for record in records])
        table = Table("Gaussians", "degree", "frames", "bytes a frame", "mean dB", "least dB")
        for name in ("memory", "CPU", "wall"):
            table.add_column(name)
        table.add_row(
            f"{config.gaussians}",
            f"{config.sh_degree}",
            f"{reader.num_frames}",
            f"{played_bytes / reader.num_frames:,.0f}",
            f"{np.nanmean(scores_db):.2f}",
            f"{np.nanmin(scores_db):.2f}",
            f"{usage.ru_maxrss / 1024:,.0f} MB",
            f"{usage.ru_utime + usage.ru_stime:.0f} s",
            f"{wall_s:.0f} s",
        )
        Console(width=130).print(table)


if __name__ == "__main__":
    run_command(
        ShuffledConfig, run, "scripts/bench shuffled", "Measures the import of a long sequence."
    )
