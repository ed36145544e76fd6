"""One sequence in every format that can hold it: bytes per frame, largest errors, and PSNR.

Usage: scripts/bench neighbours [--gs N] [--frames F]
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from codec.arrays import Doubles
from codec.console import run_command
from codec.errors import InvalidError
from codec.foreign.tsog import encode_tsog
from codec.interop.formats import (
    SplatFormat,
    contained_frames,
    encode_splats,
    read_splats,
    write_splats,
)
from codec.sequence.importing import ImportOptions, cameras_around, facing_camera, import_stream
from codec.sequence.slotfiller import ErrorBound
from codec.splats import Splats
from codec.stream import StreamReader
from player.streamcommand import draw_poster
from tests.support.alike import KINDS, largest_errors
from tests.support.slots.rotating import turned
from tests.support.trained_like import trained_like_splats

FPS = 30.0
TURN_RAD = np.radians(1)
"""Angle per frame of the turning Gaussians."""
NEW_SHARE = 0.01
"""Share of the Gaussians that appear in each frame; as many disappear."""
ROOM_M = 4.0
"""Gaussians farther than this from the middle are left out of the scene."""
SAMPLES = 3
"""Number of frames that are compared with their source."""
NEAR_M = 0.01

Decode = Callable[[int], Splats]
"""Decodes the Gaussians of a frame."""


@dataclass(frozen=True, slots=True)
class NeighboursConfig:
    """Writes a generated sequence in each format."""

    gs: int = 20_000
    """Gaussians of a frame."""
    frames: int = 60
    """Frames of the sequence."""

    def __post_init__(self) -> None:
        if self.gs < 100 or self.frames < 2:
            raise InvalidError("choose at least 100 Gaussians and 2 frames")


@cache
def _in_room(count: int) -> Splats:
    splats = trained_like_splats(count + count // 100)
    return splats.take(np.flatnonzero(np.abs(splats.means).max(axis=1) < ROOM_M)[:count])


@dataclass(frozen=True, slots=True)
class Scene:
    """A fifth of the Gaussians turns, the rest stands still, all with noise; some come and go.

    It has no harmonics, because not every format has them.
    """

    gs: int
    num_frames: int

    @property
    def num_ever(self) -> int:
        """Gaussians that appear in any frame."""
        return round(self.gs * (1 + NEW_SHARE * (self.num_frames - 1)))

    def frame(self, number: int) -> Splats:
        splats = _in_room(self.num_ever)
        rng = np.random.default_rng(number)
        moves = np.random.default_rng(0).random(self.num_ever) < 0.2
        spun = turned(splats, TURN_RAD * number)
        sigmas = 1e-4, 0.005, 0.001, 0.01, 0.003
        arrays = []
        for still, turning, sigma in zip(splats.arrays, spun.arrays, sigmas, strict=True):
            array = np.where(moves.reshape(-1, *(1,) * (still.ndim - 1)), turning, still)
            arrays.append((array + rng.normal(0, sigma, array.shape)).astype(np.float32))
        first = round(NEW_SHARE * self.gs * number)
        return Splats(*arrays).take(np.arange(first, min(first + self.gs, self.num_ever)))

    def frames(self) -> list[Splats]:
        return [self.frame(number) for number in range(self.num_frames)]


@dataclass(frozen=True, slots=True)
class Row:
    """A format with its bytes and its errors."""

    name: str
    frame_bytes: float
    errors: Doubles
    """(5,) largest errors, in the order of KINDS."""
    psnr_db: float


def compared(name: str, scene: Scene, num_bytes: float, decode: Decode) -> Row:
    """The row of a format that takes `num_bytes` in total."""
    numbers = sorted({round(f) for f in np.linspace(0, scene.num_frames - 1, SAMPLES)})
    errors, squares = np.zeros(5), []
    for number in numbers:
        wanted, found = scene.frame(number), decode(number)
        errors = np.maximum(errors, largest_errors(found, wanted))
        means = wanted.means.astype(np.float64)
        lower, upper = means.min(axis=0), means.max(axis=0)
        front = facing_camera(lower, upper)
        for camera in cameras_around(front, (lower + upper) / 2):
            drawn = [np.clip(draw_poster(s, camera, NEAR_M), 0, 1) for s in (found, wanted)]
            squares.append(np.mean((drawn[0].astype(float) - drawn[1]) ** 2))
    psnr_db = float(-10 * np.log10(max(np.mean(squares), 1e-10)))
    return Row(name, num_bytes / scene.num_frames, errors, psnr_db)


def together(scene: Scene, root: Path) -> Row:
    """The row of one file that holds the sequence."""
    path = root / "all.tsog"
    path.write_bytes(encode_tsog(scene.frames(), FPS))
    frames = contained_frames(path)
    assert frames is not None
    assert len(frames) == scene.num_frames
    size = path.stat().st_size
    return compared(".tsog", scene, size, lambda number: frames[number].read(scene.gs))


def each(scene: Scene, format: SplatFormat, root: Path) -> Row:
    """The row of one file for each frame."""
    path = root / f"one.{format}"

    def decode(number: int) -> Splats:
        write_splats(path, scene.frame(number), format)
        return read_splats(path)

    sizes = [len(encode_splats(splats, format)) for splats in scene.frames()]
    return compared(f".{format}, each frame", scene, sum(sizes), decode)


def imported(scene: Scene, files: Path, finer: float, root: Path) -> Row:
    """The row of a stream."""
    options = ImportOptions(fps=FPS, error=ErrorBound(finer=finer))
    made = import_stream(files, root / f"stream{finer:g}", options)
    reader = StreamReader(root / f"stream{finer:g}")
    return compared(
        f"swings, `--error.finer {finer:g}`",
        scene,
        made.num_bytes,
        lambda number: reader.active_splats(number, made.manifest.num_layers),
    )


def table_of(rows: list[Row]) -> Table:
    table = Table(box=box.MARKDOWN)
    table.add_column("format", no_wrap=True)
    for name in ("bytes a frame", *KINDS, "dB"):
        table.add_column(name, justify="right")
    for row in rows:
        errors = [f"{error:.2g}" for error in row.errors]
        table.add_row(row.name, f"{row.frame_bytes:,.0f}", *errors, f"{row.psnr_db:.1f}")
    return table


def run(config: NeighboursConfig) -> None:
    scene, rows = Scene(config.gs, config.frames), []
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        files = root / "files"
        files.mkdir()
        for number, splats in enumerate(scene.frames()):
            write_splats(files / f"frame_{number:04d}.ply", splats, SplatFormat.PLY)
        rows += [imported(scene, files, finer, root) for finer in (1.0, 2.0, 3.0)]
        rows.append(together(scene, root))
        rows += [each(scene, format, root) for format in SplatFormat if format != SplatFormat.GLTF]
    Console(width=160).print(table_of(rows))


if __name__ == "__main__":
    what = "Compares the formats that hold a sequence."
    run_command(NeighboursConfig, run, "scripts/bench neighbours", what)
