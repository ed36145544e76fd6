"""A stream as one .splat4d file, written by the program of its authors, from the package
`splats4d`."""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import numpy.typing as npt

from codec.errors import InvalidError
from codec.foreign.splat import RECORD, splat_rows

from .sequences import BOUNDS, INSTALL, Precision
from .tracks import Tracks

PROGRAM = "splat4d"
SMALLEST = "0"
"""Level of zstd: the highest, except for very long streams."""

Records = npt.NDArray[np.void]


def find_program() -> str:
    """Where `splat4d` is. Raises InvalidError."""
    beside = Path(sys.executable).with_name(PROGRAM)
    found = str(beside) if beside.is_file() else shutil.which(PROGRAM)
    if found is None:
        raise InvalidError(f"splat4d is written by the package splats4d: {INSTALL}")
    return found


def _frames(tracks: Tracks) -> Iterator[tuple[Records, float]]:
    """The records of all places that are ever used, one of opacity 0 where there is no Gaussian,
    and the median standard deviation, frame by frame. The format wants the same Gaussians in every
    frame."""
    held = np.zeros(tracks.num_slots, RECORD)
    is_used = np.zeros(len(held), np.bool_)
    for frame in tracks:
        fresh = frame.slots[~is_used[frame.slots]]
        is_used[fresh] = True
        held[fresh] = splat_rows(frame.splats)[np.searchsorted(frame.slots, fresh)]
    for frame in tracks:
        held["rgba"][:, 3] = 0
        held[frame.slots] = splat_rows(frame.splats)
        sizes_m = np.exp(frame.splats.log_scales)
        yield held[is_used], float(np.median(sizes_m)) if sizes_m.size else np.nan


def write_splat4d(path: Path, tracks: Tracks, precision: Precision) -> None:
    """Writes the .splat4d file of `tracks`, without harmonics, to `path`.

    The program reads a .splat file for each frame, and checks its errors against them. Raises
    InvalidError without it, or for a sequence that it cannot take; or a CodecError of the stream.
    """
    program, bounds = find_program(), BOUNDS[precision]
    with tempfile.TemporaryDirectory() as folder:
        sizes_m = []
        for number, (rows, size_m) in enumerate(_frames(tracks)):
            if not len(rows):
                raise InvalidError(f"splat4d: {tracks.name} shows no Gaussian in these frames")
            (Path(folder) / f"frame_{number:06d}.splat").write_bytes(rows.tobytes())
            sizes_m.append(size_m)
        done = subprocess.run(
            [
                *(program, "encode", "--input", folder, "--output", str(path)),
                *("--fps", f"{tracks.fps:.9g}", "--zstd-level", SMALLEST),
                *("--pos-mm", f"{1e3 * bounds.position * float(np.nanmedian(sizes_m)):.6g}"),
                *("--scale-pct", f"{100 * bounds.size:.6g}"),
                *("--color-levels", str(bounds.levels), "--rot-steps", str(bounds.turn)),
            ],
            capture_output=True,
            text=True,
            check=False,
        )
    if done.returncode or not path.is_file():
        said = (done.stderr or done.stdout).strip().splitlines()
        reason = said[-1] if said else f"it ended with {done.returncode}"
        raise InvalidError(f"splat4d: the program cannot write this sequence: {reason}")
