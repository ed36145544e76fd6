"""Several streams of one capture side by side: bytes fetched against PSNR, and PSNR frame by frame.

Usage: scripts/bench curve STREAM STREAM ... --capture CAPTURE --out docs/curve.png

Every stream is scored from its decoded files on the held-out cameras, at every number of layers.
"kB a frame" is everything that a player starting at frame 0 fetches (objects, index and manifest),
divided by the number of frames. Scores are kept as JSON in --work, so that a plot with one more
stream scores only the new one; empty that folder after a change of the renderer, the scores or the
capture.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Annotated, Any

os.environ.setdefault("OMP_WAIT_POLICY", "passive")

import matplotlib.axes
import matplotlib.backends.backend_agg
import matplotlib.figure
import matplotlib.ticker
import tyro
from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from codec.console import option, run_command
from codec.errors import InvalidError
from codec.files import write_atomic
from codec.stream import StreamReader
from codec.stream.manifest import MANIFEST_NAME
from codec.stream.segment import INDEX_NAME
from trainer.score.evaluate import EvaluateConfig, Evaluation, LayerScore, evaluate_stream

COLOURS = ("#1f5fbf", "#d9480f", "#2b8a3e", "#862e9c", "#0b7285", "#a61e4d", "#5c940d", "#6b7280")
"""Colours of the streams, in turn."""
PUBLISHED_COLOUR = "#212529"
DECADE = 10
"""Ratio of the highest rate to the lowest from which the axis has fewer ticks."""


@dataclass(frozen=True, slots=True)
class Published:
    """A published result on the same capture."""

    name: str
    kb_per_frame: float
    psnr_db: float

    @classmethod
    def parse(cls, text: str) -> Published:
        """Parses NAME:KB:DB; the name may contain colons. Raises InvalidError."""
        name, *numbers = text.rsplit(":", 2)
        try:
            kb, db = (float(number) for number in numbers)
        except ValueError:
            kb = db = math.nan
        if not name or not math.isfinite(db) or not 0 < kb < math.inf:
            raise InvalidError(
                f"{text!r} is not NAME:KB:DB, a name, its kB a frame and its PSNR in dB"
            )
        return cls(name, kb, db)

    def __str__(self) -> str:
        return f"{self.name}:{self.kb_per_frame:g}:{self.psnr_db:g}"


PUBLISHED = option("NAME:KB:DB", Published.parse)


@dataclass(frozen=True, slots=True)
class CurveConfig:
    """Draws rate against PSNR, and PSNR by frame, for several streams of one capture."""

    streams: Annotated[
        tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="STREAM [STREAM ...]")
    ]
    """Folders of the streams."""
    capture: Path
    """Folder of the capture that all of them were trained from."""
    out: Path = Path("docs/curve.png")
    """The plot to write."""
    work: Path = field(default_factory=lambda: Path(tempfile.gettempdir()) / "swings-curve")
    """Folder that keeps the scores."""
    published: tuple[Annotated[Published, PUBLISHED], ...] = ()
    """Published points to draw beside the streams."""
    every: int = 1
    """Score every n-th frame; flicker needs 1."""


@dataclass(frozen=True, slots=True)
class Curve:
    """One stream and its scores."""

    name: str
    """A name for people, different from those of the other streams."""
    first_frame: int
    """Frame of the capture at which the stream begins."""
    every: int
    found: Evaluation

    @property
    def frames(self) -> range:
        """The frames scored, by their number in the capture."""
        return range(self.first_frame, self.first_frame + self.found.frames, self.every)


def names_of(streams: Sequence[Path]) -> list[str]:
    """The folders' names if all differ, else their paths."""
    short = [stream.resolve().name for stream in streams]
    return short if len(set(short)) == len(short) else [str(stream) for stream in streams]


def kept_path(stream: Path, config: CurveConfig) -> Path:
    """Path of the kept scores of this stream. The name changes with the stream's bytes, the
    capture, the step and the kind of scores; the index identifies the bytes of all objects."""
    told: dict[str, Any] = {
        "capture": str(config.capture.resolve()),
        "every": config.every,
        "fields": [f.name for kind in (Evaluation, LayerScore) for f in fields(kind)],
    }
    digest = hashlib.sha256(json.dumps(told).encode())
    for name in (MANIFEST_NAME, INDEX_NAME):
        digest.update(hashlib.sha256((stream / name).read_bytes()).digest())
    return config.work / f"{digest.hexdigest()[:16]}.json"


def recall(path: Path) -> Evaluation:
    told = json.loads(path.read_text(encoding="utf-8"))
    layers = [LayerScore(**layer) for layer in told.pop("layers")]
    return Evaluation(**told, layers=layers)


def measure(config: CurveConfig) -> list[Curve]:
    """Scores all streams; prints a line on standard error for each."""
    log = Console(stderr=True)
    config.work.mkdir(parents=True, exist_ok=True)
    curves = []
    for name, stream in zip(names_of(config.streams), config.streams, strict=True):
        first_frame = StreamReader(stream).manifest.capture_frame
        path = kept_path(stream, config)
        was_kept = path.is_file()
        if not was_kept:
            found = evaluate_stream(EvaluateConfig(stream, config.capture, every=config.every))
            write_atomic(path, json.dumps(found.to_json(), indent=1).encode())
        curve = Curve(name, first_frame, config.every, recall(path))
        text = f"{name}: {curve.found.layers[-1].psnr_db:.2f} dB"
        log.print(text + ", kept from before" * was_kept, highlight=False, markup=False)
        curves.append(curve)
    return curves


def table_of(curves: Sequence[Curve]) -> Table:
    """A row for each stream and number of layers."""
    table = Table(box=box.MARKDOWN)
    table.add_column("stream")
    for name in ("layers", "PSNR dB", "moving dB", "flicker", "kB a frame"):
        table.add_column(name, justify="right")
    for curve in curves:
        for row in curve.found.layers:
            table.add_row(
                escape(curve.name),
                str(row.layers),
                f"{row.psnr_db:.2f}",
                "-" if row.moving_psnr_db is None else f"{row.moving_psnr_db:.2f}",
                "-" if row.flicker is None else f"{row.flicker:.3f}",
                f"{row.bytes_per_frame / 1e3:.1f}",
            )
    return table


def draw_rates(
    axes: matplotlib.axes.Axes, curves: Sequence[Curve], published: Sequence[Published]
) -> None:
    """Draws a point for each number of layers, and a line for each stream."""
    rates_kb = [point.kb_per_frame for point in published]
    for number, curve in enumerate(curves):
        x_kb = [row.bytes_per_frame / 1e3 for row in curve.found.layers]
        y_db = [row.psnr_db for row in curve.found.layers]
        axes.plot(
            x_kb, y_db, "-o", color=COLOURS[number % len(COLOURS)], markersize=5, label=curve.name
        )
        rates_kb += x_kb
    axes.set_xlim(min(rates_kb) / 1.3, max(rates_kb) * 1.3)
    for point in published:
        # The name extends towards the middle, so that it stays inside the axes.
        right = point.kb_per_frame**2 > min(rates_kb) * max(rates_kb)
        axes.plot([point.kb_per_frame], [point.psnr_db], "D", color=PUBLISHED_COLOUR, markersize=5)
        axes.annotate(
            point.name, (point.kb_per_frame, point.psnr_db), xytext=(-7 if right else 7, 0),
            textcoords="offset points", ha="right" if right else "left", va="center",
            fontsize=8, color=PUBLISHED_COLOUR,
        )  # fmt: skip
    axes.set_xscale("log")
    low, high = axes.get_xlim()
    subs = (1, 1.5, 2, 3, 5, 7) if high < DECADE * low else (1, 3)
    axes.xaxis.set_major_locator(matplotlib.ticker.LogLocator(subs=subs))
    axes.xaxis.set_major_formatter(matplotlib.ticker.FormatStrFormatter("%g"))
    axes.xaxis.set_minor_formatter(matplotlib.ticker.NullFormatter())
    axes.set_xlabel("kB per frame, logarithmic; all bytes of a play from frame 0")
    axes.set_title("one point per number of layers", fontsize=10)


def draw_frames(axes: matplotlib.axes.Axes, curves: Sequence[Curve]) -> None:
    """Draws the PSNR of each frame, with all layers."""
    for number, curve in enumerate(curves):
        y_db = curve.found.layers[-1].per_frame_psnr_db
        # One or two frames alone show too little of a line.
        marker = "." if len(y_db) < 3 else ""
        axes.plot(
            curve.frames, y_db, marker=marker, color=COLOURS[number % len(COLOURS)], linewidth=1.3
        )
    axes.xaxis.set_major_locator(matplotlib.ticker.MaxNLocator(integer=True))
    axes.set_xlabel("frame of the capture")
    axes.set_title("all layers", fontsize=10)


def draw(curves: Sequence[Curve], config: CurveConfig) -> None:
    figure = matplotlib.figure.Figure(figsize=(11, 5), layout="constrained")
    matplotlib.backends.backend_agg.FigureCanvasAgg(figure)
    rates, frames = figure.subplots(1, 2)
    draw_rates(rates, curves, config.published)
    draw_frames(frames, curves)
    for axes in (rates, frames):
        axes.set_ylabel("PSNR, dB, held-out cameras")
        axes.margins(y=0.1)
        axes.grid(alpha=0.3)
    figure.suptitle(config.capture.resolve().name, fontsize=11)
    figure.legend(loc="outside lower center", ncols=min(len(curves), 4), fontsize=9)
    config.out.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(config.out, dpi=120, metadata={"Software": None})


def run(config: CurveConfig) -> None:
    if not config.streams:
        raise InvalidError("give at least one stream")
    curves = measure(config)
    Console(width=110).print(table_of(curves))
    draw(curves, config)


if __name__ == "__main__":
    run_command(CurveConfig, run, "scripts/bench curve", "Compares streams of one capture.")
