"""Bytes of spherical harmonics of degree 1 to 3, coded in several ways: as a stream of each degree,
with one step for all harmonics, and with a palette of rows as in SOG. A sequence is coded only as
streams.

PSNR is against the source with all its harmonics. Usage: scripts/bench harmonics [--gs N]
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table
from scipy.spatial import cKDTree

from codec.arrays import Bytes, Floats
from codec.coders.blocks import Effort
from codec.coders.zstd import compress
from codec.console import run_command
from codec.errors import InvalidError
from codec.foreign.sog import codebook, codes_of, palette
from codec.interop.formats import SplatFormat, write_splats
from codec.lattice.forms import from_luma, to_luma
from codec.sequence.importing import ImportOptions, cameras_around, facing_camera, import_stream
from codec.sequence.slotfiller import ErrorBound
from codec.splats import Splats
from codec.stream import StreamReader
from player.streamcommand import draw_poster
from tests.support.deforming import FPS, Deforming
from tests.support.trained_like import trained_like_splats

ROOM_M = 4.0
"""Gaussians farther than this from the middle are left out of the model."""
MATERIALS, GRAIN = 300, 0.01
"""Rows of harmonics in the second model, and the noise of each Gaussian around its row."""
STEPS = 0.04, 0.08, 0.16, 0.32
PALETTES = 256, 1024, 4096, 16384
EVERY = 10
"""Step between compared frames."""
NEAR_M = 0.01


@dataclass(frozen=True, slots=True)
class HarmonicsConfig:
    """Codes generated still models of degree 3 in several ways."""

    gs: int = 20_000
    """Gaussians of a model; a frame of the sequence has half as many."""
    frames: int = 30
    """Frames of the sequence, the same as that of `scripts/bench shuffled`."""

    def __post_init__(self) -> None:
        if self.gs < 1000 or self.frames < 1:
            raise InvalidError("choose at least 1000 Gaussians and a frame")


def models(count: int) -> Iterator[tuple[str, Splats]]:
    """Two models by name: each Gaussian has its own harmonics, or those of one of 300 materials."""
    splats = trained_like_splats(count, 0, 3)
    splats = splats.take(np.flatnonzero(np.abs(splats.means).max(axis=1) < ROOM_M))
    yield "own harmonics", splats
    rng = np.random.default_rng(1)
    rows = splats.sh[rng.integers(0, MATERIALS, len(splats))]
    sh = (rows + rng.normal(0, GRAIN, rows.shape)).astype(np.float32)
    sh[:, 0] = splats.sh[:, 0]
    yield "300 materials", Splats(*splats.arrays[:4], sh)


class Model:
    """A model as a stream, and its pictures."""

    def __init__(self, splats: Splats, root: Path) -> None:
        self._root, self.splats = root, splats
        write_splats(root / "model.ply", splats, SplatFormat.PLY)
        means = splats.means.astype(np.float64)
        lower, upper = np.percentile(means, (1, 99), axis=0)
        self._cameras = cameras_around(facing_camera(lower, upper), (lower + upper) / 2)
        self._wanted = [self._drawn(splats, number) for number in range(len(self._cameras))]

    def _drawn(self, splats: Splats, number: int) -> Floats:
        drawn: Floats = np.clip(draw_poster(splats, self._cameras[number], NEAR_M), 0, 1)
        return drawn

    def psnr_db(self, splats: Splats) -> float:
        """The PSNR of the pictures of `splats` against those of the model."""
        pairs = enumerate(self._wanted)
        squares = [np.mean((self._drawn(splats, n) - wanted) ** 2) for n, wanted in pairs]
        return float(-10 * np.log10(max(np.mean(squares), 1e-10)))

    def stream(self, degree: int, finer: float = 1.0) -> tuple[int, Splats]:
        """Bytes of the model as a stream, and the decoded Gaussians."""
        out = self._root / f"stream {degree} {finer:g}"
        options = ImportOptions(
            fps=30, sh_degree=degree, by_paint=True, error=ErrorBound(finer=finer)
        )
        made = import_stream(self._root / "model.ply", out, options)
        return made.num_bytes, StreamReader(out).active_splats(0, made.manifest.num_layers)


def packed_bytes(planes: Bytes) -> int:
    """Bytes of (P, N) planes as a packet."""
    edges = [n * planes.shape[1] for n in range(len(planes) + 1)]
    return len(compress(planes.tobytes(), edges, effort=Effort.MOST))


def scalar(rest: Floats, step: float) -> tuple[int, Floats]:
    """Bytes of (N, K, 3) harmonics as multiples of a step of Y, Co and Cg, and the harmonics."""
    steps = np.clip(np.rint(to_luma(rest.astype(np.float64)) / step), -128, 127)
    planes = steps.astype(np.int8).view(np.uint8).reshape(len(rest), -1).T
    y, co, cg = np.moveaxis((steps * step).astype(np.float32), -1, 0)
    return packed_bytes(np.ascontiguousarray(planes)), np.stack(from_luma(y, co, cg), axis=-1)


def by_palette(rest: Floats, size: int) -> tuple[int, Floats]:
    """Bytes of (N, K, 3) harmonics as labels of `size` rows of 8-bit codes, and the harmonics."""
    entries, labels = palette(rest.reshape(len(rest), -1), size)
    book = codebook(entries)
    codes = codes_of(entries, book)
    planes = np.stack([labels & 255, labels >> 8]).astype(np.uint8)
    num_bytes = packed_bytes(planes) + packed_bytes(np.ascontiguousarray(codes.T)) + book.nbytes
    return num_bytes, book[codes][labels].reshape(rest.shape)


def rows_of(model: Model) -> Iterator[tuple[str, int, float]]:
    """The name, bytes and PSNR of each way to code the model."""
    base = 0
    for degree in range(4):
        num_bytes, found = model.stream(degree)
        base = base or num_bytes
        yield f"stream of degree {degree}", num_bytes, model.psnr_db(found)
    for finer in (0.5, 1.4):
        num_bytes, other = model.stream(3, finer)
        yield f"stream of degree 3, `--error.finer {finer:g}`", num_bytes, model.psnr_db(other)
    # The harmonics as they are in the source, in the order of the stream.
    source = cKDTree(model.splats.means).query(found.means)[1]
    rest = model.splats.sh[source, 1:]

    def coded(made: Floats) -> float:
        sh = np.concatenate([found.sh[:, :1], made.astype(np.float32)], axis=1)
        return model.psnr_db(Splats(*found.arrays[:4], sh))

    yield "degree 0, and harmonics as they are", base + rest.nbytes, coded(rest)
    for step in STEPS:
        num_bytes, made = scalar(rest, step)
        yield f"degree 0, and steps of {step:g}", base + num_bytes, coded(made)
    for size in PALETTES:
        if size < len(rest):
            num_bytes, made = by_palette(rest, size)
            yield f"degree 0, and a palette of {size}", base + num_bytes, coded(made)


def sequence_rows(config: HarmonicsConfig, root: Path) -> Iterator[tuple[str, int, float]]:
    """The name, bytes of a whole play and mean PSNR of a sequence's stream of each degree."""
    deforming, files = Deforming(config.gs // 2, 3), root / "files"
    files.mkdir()
    models = {}
    for number in range(config.frames):
        splats = deforming.next()
        write_splats(files / f"frame_{number:04d}.ply", splats, SplatFormat.PLY)
        if number % EVERY == 0:
            models[number] = Model(splats, root)
    for degree, finer in ((0, 1.0), (1, 1.0), (2, 1.0), (3, 1.0), (3, 0.5)):
        out = root / f"sequence {degree} {finer:g}"
        error = ErrorBound(finer=finer)
        options = ImportOptions(fps=FPS, sh_degree=degree, by_paint=True, error=error)
        made = import_stream(files, out, options)
        reader, layers = StreamReader(out), made.manifest.num_layers
        num_bytes = sum(record.played_bytes for record in reader.records)
        psnr_db = np.mean(
            [model.psnr_db(reader.active_splats(n, layers)) for n, model in models.items()]
        )
        yield f"degree {degree}, `--error.finer {finer:g}`", num_bytes, float(psnr_db)


def run(config: HarmonicsConfig) -> None:
    console = Console(width=120)
    table = Table(f"{config.frames} frames, {config.gs // 2} Gaussians", box=box.MARKDOWN)
    for column in ("bytes", "bytes a frame", "dB"):
        table.add_column(column, justify="right")
    with tempfile.TemporaryDirectory() as folder:
        for way, num_bytes, psnr_db in sequence_rows(config, Path(folder)):
            table.add_row(
                way, f"{num_bytes:,}", f"{num_bytes / config.frames:,.0f}", f"{psnr_db:.2f}"
            )
    console.print(table)
    for name, splats in models(config.gs):
        table = Table(f"{len(splats)} Gaussians, {name}", box=box.MARKDOWN)
        for column in ("bytes", "bytes a Gaussian", "dB"):
            table.add_column(column, justify="right")
        with tempfile.TemporaryDirectory() as folder:
            for way, num_bytes, psnr_db in rows_of(Model(splats, Path(folder))):
                share = f"{num_bytes / len(splats):.1f}"
                table.add_row(way, f"{num_bytes:,}", share, f"{psnr_db:.2f}")
        console.print(table)


if __name__ == "__main__":
    run_command(HarmonicsConfig, run, "scripts/bench harmonics", "Measures harmonics in bytes.")
