"""Rate and distortion of slices that are sent whole: bytes per frame against PSNR, as float32 and
on the lattice, for each rank and number of layers.

Usage: scripts/bench rate STREAM CAPTURE --out docs/rate.png

Every curve is a new stream, written from the Gaussians of the given stream and scored from its
decoded files on the held-out cameras. Rank `contribution` orders a slice by the blending weight of
its Gaussians, summed over all frames in which they show and over all training cameras.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import matplotlib.backends.backend_agg
import matplotlib.figure
import tyro
from rich import box
from rich.console import Console
from rich.table import Table

from codec.console import run_command
from codec.slice import Slice
from codec.stream import StreamReader, StreamWriter
from codec.stream.manifest import Manifest
from trainer.capture.layout import open_capture
from trainer.run.outputs import CONTRIBUTION, slices_by_contribution, writer_rank
from trainer.score.evaluate import EvaluateConfig, Evaluation, LayerScore, evaluate_stream
from trainer.step.raster import View

COLOURS = {"float32": "#6b7280", "lattice": "#1f5fbf"}
"""Colours of the ways to code the Gaussians."""
LINES = {"opacity": ("--", "s"), CONTRIBUTION: ("-", "o")}
"""Line and marker of each rank."""


@dataclass(frozen=True, slots=True)
class RateConfig:
    """Draws bytes per frame against PSNR for every coding, rank and number of layers."""

    stream: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="STREAM")]
    """Folder of the stream, preferably one that stores every value as float32."""
    capture: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="CAPTURE")]
    """Folder of the capture that the stream was trained from."""
    out: Path = Path("docs/rate.png")
    """The plot to write."""
    every: int = 1
    """Score every n-th frame."""


@dataclass(frozen=True, slots=True)
class Curve:
    """One coding and rank, with scores by number of layers, fewest first."""

    coding: str
    rank: str
    scores: list[LayerScore]


def ranked_slices(reader: StreamReader, config: RateConfig) -> dict[str, list[Slice]]:
    """The slices to give to a writer, for each rank of LINES."""
    manifest, capture = reader.manifest, open_capture(config.capture)
    names = [capture.cameras[i].camera.name for i in capture.training]
    views = [View.prepare(c, manifest.near_of(c)) for c in map(manifest.camera, names)]
    return {
        "opacity": list(reader.slices(manifest.first_birth, manifest.num_layers)),
        CONTRIBUTION: list(slices_by_contribution(reader, views)),
    }


def score(
    manifest: Manifest, coding: str, rank: str, slices: Sequence[Slice], config: RateConfig
) -> Evaluation:
    """Writes `slices` to a temporary stream of `manifest` and scores its files."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "stream"
        exact = coding == "float32"
        with StreamWriter.create(path, manifest, writer_rank(rank), exact=exact) as writer:
            for part in slices:
                writer.append(part)
        return evaluate_stream(EvaluateConfig(path, config.capture, every=config.every))


def measure(config: RateConfig) -> list[Curve]:
    reader = StreamReader(config.stream)
    log = Console(stderr=True)
    curves = []
    for rank, slices in ranked_slices(reader, config).items():
        for coding in COLOURS:
            log.print(f"{coding}, {rank}")
            found = score(reader.manifest, coding, rank, slices, config)
            curves.append(Curve(coding, rank, found.layers))
    return curves


def table_of(curves: Sequence[Curve], shares: Sequence[float]) -> Table:
    table = Table(box=box.MARKDOWN)
    table.add_column("as")
    table.add_column("rank")
    for name in ("layers", "Gaussians", "kB/frame", "bytes/Gaussian", "PSNR dB", "SSIM"):
        table.add_column(name, justify="right")
    for curve in curves:
        for row in curve.scores:
            table.add_row(
                curve.coding,
                curve.rank,
                f"{row.layers}",
                f"{sum(shares[: row.layers]):.0%}",
                f"{row.bytes_per_frame / 1e3:.1f}",
                f"{row.bytes_per_gaussian:.2f}",
                f"{row.psnr_db:.2f}",
                f"{row.ssim:.3f}",
            )
    return table


def draw(curves: Sequence[Curve], title: str, path: Path) -> None:
    figure = matplotlib.figure.Figure(figsize=(8, 5.8), layout="constrained")
    matplotlib.backends.backend_agg.FigureCanvasAgg(figure)
    axes = figure.subplots()
    for curve in curves:
        line, marker = LINES[curve.rank]
        colour = COLOURS[curve.coding]
        x_kb = [row.bytes_per_frame / 1e3 for row in curve.scores]
        y_db = [row.psnr_db for row in curve.scores]
        axes.plot(
            x_kb, y_db, line, marker=marker, color=colour, markersize=5,
            label=f"{curve.coding}, {curve.rank}",
        )  # fmt: skip
        above = curve.rank == CONTRIBUTION
        for row, x, y in zip(curve.scores, x_kb, y_db, strict=True):
            axes.annotate(
                f"{row.layers}", (x, y), xytext=(-7, 5) if above else (7, -11),
                textcoords="offset points", ha="center", fontsize=8, color=colour,
            )  # fmt: skip
    axes.set_xscale("log")
    ticks = [20, 50, 100, 200, 500, 1000]
    axes.set_xticks(ticks, [f"{tick}" for tick in ticks])
    axes.set_xticks([], minor=True)
    low, high = (f(row.bytes_per_frame for c in curves for row in c.scores) for f in (min, max))
    axes.set_xlim(low / 1e3 / 1.2, high / 1e3 * 1.2)
    axes.set_xlabel("kB per frame, logarithmic")
    axes.set_ylabel("PSNR, dB, held-out cameras")
    axes.set_title(title, fontsize=10)
    axes.grid(alpha=0.3)
    figure.legend(
        loc="outside lower center", ncols=len(LINES), fontsize=9,
        title="coding, rank; one point per number of layers",
    )  # fmt: skip
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=120, metadata={"Software": None})


def run(config: RateConfig) -> None:
    curves = measure(config)
    reader = StreamReader(config.stream)
    manifest, camera = reader.manifest, reader.manifest.camera()
    Console(width=110).print(table_of(curves, manifest.layers))
    title = (
        f"{manifest.title}: {reader.num_frames} frames, {camera.width_px}x{camera.height_px}, "
        f"{manifest.num_gs:,} Gaussians, swin_size {manifest.swin_size}"
    )
    draw(curves, title, config.out)


if __name__ == "__main__":
    run_command(RateConfig, run, "scripts/bench rate", "Draws rate against distortion.")
