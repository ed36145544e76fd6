"""Quality of a stream after dropping Gaussians, as in the paper's Figures 9 to 12: the least opaque
(its section 5.5), those that contribute least, and the stream's own last layers.

Usage: scripts/bench dropping STREAM --capture CAPTURE --out docs/dropping.png

Each Gaussian has one rank for its whole life; the highest-ranking share of every slice is kept.
Contribution is the trainer's: blending weight in pictures of training cameras.

The bytes are real. The kept Gaussians are written as a stream of their own, with the same lattices
and layers, which costs no precision. These files are scored, and their bytes are all that a player
starting at frame 0 fetches. With 100 % the files are those of the stream.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from codec.arrays import Bytes, Floats

os.environ.setdefault("OMP_WAIT_POLICY", "passive")

import matplotlib.axes
import matplotlib.backends.backend_agg
import matplotlib.figure
import numpy as np
import tyro
from PIL import Image, ImageDraw, ImageFont
from rich import box
from rich.console import Console
from rich.table import Table

from bench.dropped import Drop, contributions, lives_of, opacities, places, write_kept
from codec.camera import Camera
from codec.console import run_command
from codec.errors import InvalidError
from codec.files import replacing
from codec.stream import StreamReader
from trainer.pictures.scale import Shot
from trainer.score.scores import traffic
from trainer.score.truth import ScoredCameras, captured, displayed, open_held_out
from trainer.step.loss import psnr_db
from trainer.step.raster import View

BY_OPACITY, BY_CONTRIBUTION, LAYERS = "by opacity", "by contribution", "layers"
"""Ways to choose the Gaussians to keep."""
STYLES = {
    BY_OPACITY: ("#d9480f", "--s", "tail-dropped by opacity"),
    BY_CONTRIBUTION: ("#1f5fbf", "-.^", "tail-dropped by contribution"),
    LAYERS: ("#2b8a3e", "-o", "the stream's own layers"),
}
"""Colour, line with marker, and text in the legend of each."""
SHEET_PX, CAPTION_PX, GAP_PX = 1600, 20, 4
"""Width of the contact sheet, height of a caption, and gap between two pictures, pixels."""
JPEG_QUALITY = 85


@dataclass(frozen=True, slots=True)
class DroppingConfig:
    """Draws a stream with a share of its Gaussians, beside the stream's own layers."""

    stream: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="STREAM")]
    """Folder of the stream."""
    capture: Path
    """Folder of the capture that the stream was trained from."""
    out: Path = Path("docs/dropping.png")
    """The plot to write."""
    sheet: Path = Path("docs/dropping.jpg")
    """The contact sheet to write, a JPEG."""
    shares: tuple[float, ...] = (1.0, 0.8, 0.6, 0.4, 0.2)
    """Shares of the Gaussians to keep, as in the paper."""
    every: int = 10
    """Score every n-th frame. Bytes and ranks always cover all frames."""
    views: int = 6
    """Training cameras per frame in which contributions are counted; all cameras take turns."""
    frame: int | None = None
    """Frame on the contact sheet; None: the middle one of the scored frames."""
    camera: str | None = None
    """Held-out camera on the contact sheet; None: the first."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """A part of the Gaussians, scored and counted."""

    chosen: str
    """Key of STYLES."""
    name: str
    share: float
    """Share of the Gaussians of a slice."""
    bytes_per_frame: float
    """Bytes fetched by a player that starts at frame 0, per frame."""
    psnr_db: float
    """Mean over held-out cameras and scored frames."""
    picture: Bytes
    """(H, W, 3) its picture on the contact sheet."""
    picture_db: float


@dataclass(frozen=True, slots=True)
class Comparison:
    outcomes: list[Outcome]
    """In the order of STYLES, each from most Gaussians to fewest."""
    truth: Bytes
    """(H, W, 3) the captured picture of the contact sheet's camera."""
    truth_name: str
    title: str

    def of(self, chosen: str) -> list[Outcome]:
        return [outcome for outcome in self.outcomes if outcome.chosen == chosen]


def training_views(held_out: ScoredCameras) -> list[View]:
    """The training cameras at the size of the stream, prepared."""
    manifest, capture = held_out.reader.manifest, held_out.cache.capture
    names = [capture.cameras[i].camera.name for i in capture.training]
    return [View.prepare(c, manifest.near_of(c)) for c in map(manifest.camera, names)]


@dataclass(slots=True)
class Source:
    """A stream at a number of layers, to be scored."""

    reader: StreamReader
    layers: int
    psnr_db: list[list[float]] = field(default_factory=list)
    """One list for each scored frame, with one value for each camera."""

    def score(self, held_out: ScoredCameras, frame: int, truths: Sequence[Floats]) -> None:
        """Adds the scores of `frame`; truths: the captured pictures."""
        splats = self.reader.active_splats(frame, self.layers)
        manifest, shots = self.reader.manifest, held_out.shots(frame)
        shown = [displayed(splats, c, manifest.near_of(c)) for c in held_out.cameras]
        triples = zip(shown, truths, shots, strict=True)
        self.psnr_db.append([psnr_db(x, truth, shot.mask) for x, truth, shot in triples])

    @property
    def bytes_per_frame(self) -> float:
        fetched = traffic(self.reader)[self.layers - 1].object_bytes
        return (fetched + self.reader.overhead_bytes) / self.reader.num_frames


@dataclass(frozen=True, slots=True)
class Candidate:
    """A part of the Gaussians, from which an Outcome is made."""

    chosen: str
    name: str
    share: float
    source: Source

    def outcome(self, frame: int, camera: Camera, shot: Shot) -> Outcome:
        """Requires a scored source. frame, camera, shot: those of the contact sheet."""
        source = self.source
        splats = source.reader.active_splats(frame, source.layers)
        shown = displayed(splats, camera, source.reader.manifest.near_of(camera))
        return Outcome(
            self.chosen,
            self.name,
            self.share,
            source.bytes_per_frame,
            float(np.mean(source.psnr_db)),
            np.rint(255 * shown).astype(np.uint8),
            psnr_db(shown, captured(shot.picture), shot.mask),
        )


def candidates(held_out: ScoredCameras, config: DroppingConfig, folder: Path) -> list[Candidate]:
    """Everything to score; the streams written for it are in `folder`."""
    log = Console(stderr=True)
    reader, manifest = held_out.reader, held_out.reader.manifest
    lives = lives_of(reader)
    log.print("ranking by opacity and by contribution", highlight=False)
    views = training_views(held_out)
    ranks = {
        BY_OPACITY: places(opacities(reader, lives)),
        BY_CONTRIBUTION: places(contributions(reader, lives, views, min(config.views, len(views)))),
    }
    shares = sorted(set(config.shares), reverse=True)
    chosen = [(how, share) for how in ranks for share in shares]
    drops = {(how, share): Drop(share, ranks[how]) for how, share in chosen if share < 1}
    log.print(f"writing {len(drops)} streams of the kept Gaussians", highlight=False)
    paths = dict(zip(drops, write_kept(reader, lives, list(drops.values()), folder), strict=True))
    sources = [Source(reader, layers) for layers in range(1, manifest.num_layers + 1)]
    found = []
    for how, share in chosen:
        source = sources[-1]
        if share < 1:
            source = Source(StreamReader(paths[how, share]), manifest.num_layers)
        found.append(Candidate(how, f"{share:.0%}", share, source))
    for source in reversed(sources):
        name = f"{source.layers} layer{'s' * (source.layers > 1)}"
        found.append(Candidate(LAYERS, name, sum(manifest.layers[: source.layers]), source))
    return found


def picked(held_out: ScoredCameras, config: DroppingConfig) -> tuple[int, int]:
    """Frame and held-out camera of the contact sheet. Raises InvalidError if the stream has no such
    frame or camera, or if another option is out of its bounds."""
    if not config.shares or not all(0 < share <= 1 for share in config.shares):
        raise InvalidError("give at least one share, each above 0 and at most 1")
    if config.views < 1:
        raise InvalidError(f"views {config.views}: choose 1 or more")
    scored, names = held_out.every(config.every), [camera.name for camera in held_out.cameras]
    frame = scored[len(scored) // 2] if config.frame is None else config.frame
    if not 0 <= frame < held_out.reader.num_frames:
        raise InvalidError(f"the stream has frames 0:{held_out.reader.num_frames}, not {frame}")
    if config.camera is not None and config.camera not in names:
        raise InvalidError(f"camera {config.camera!r} is not held out; choose {', '.join(names)}")
    return frame, 0 if config.camera is None else names.index(config.camera)


def measure(config: DroppingConfig) -> Comparison:
    """Ranks, writes and scores; prints a line on standard error for each step."""
    with (
        open_held_out(config.stream, config.capture) as held_out,
        tempfile.TemporaryDirectory() as folder,
    ):
        frame, which = picked(held_out, config)
        scored, manifest = held_out.every(config.every), held_out.reader.manifest
        found = candidates(held_out, config, Path(folder))
        text = f"scoring {len(scored)} frames, {len(held_out.cameras)} held-out cameras"
        Console(stderr=True).print(text, highlight=False)
        # Several candidates share the source that keeps all Gaussians; it is scored once.
        sources = {id(candidate.source): candidate.source for candidate in found}
        for number in scored:
            truths = [captured(shot.picture) for shot in held_out.shots(number)]
            for source in sources.values():
                source.score(held_out, number, truths)
        camera, shot = held_out.cameras[which], held_out.shot(which, frame)
        title = (
            f"{config.capture.resolve().name}: {manifest.num_gs:,} Gaussians, swin_size "
            f"{manifest.swin_size}; {len(scored)} of {held_out.reader.num_frames} frames scored"
        )
        return Comparison(
            [candidate.outcome(frame, camera, shot) for candidate in found],
            np.array(shot.picture),
            f"camera {camera.name}, frame {frame}",
            title,
        )


def at_same_bytes(line: Sequence[Outcome], num_bytes: float) -> float | None:
    """PSNR of `line` at `num_bytes` per frame, dB, interpolated; None outside its points."""
    points = sorted((outcome.bytes_per_frame, outcome.psnr_db) for outcome in line)
    if not points[0][0] <= num_bytes <= points[-1][0]:
        return None
    x, y_db = zip(*points, strict=True)
    return float(np.interp(np.log(num_bytes), np.log(x), y_db))


def table_of(found: Comparison) -> Table:
    """A row for each outcome. Rows of layers also have the gain over dropping by opacity, and by
    contribution, at the same bytes."""
    table = Table(box=box.MARKDOWN)
    table.add_column("kept")
    for name in (
        "Gaussians", "kB a frame", "PSNR dB", "dB over opacity", "dB over contribution",
    ):  # fmt: skip
        table.add_column(name, justify="right")
    for outcome in found.outcomes:
        same = [
            at_same_bytes(found.of(how), outcome.bytes_per_frame)
            if outcome.chosen == LAYERS
            else None
            for how in (BY_OPACITY, BY_CONTRIBUTION)
        ]
        table.add_row(
            outcome.name if outcome.chosen == LAYERS else outcome.chosen,
            f"{outcome.share:.0%}",
            f"{outcome.bytes_per_frame / 1e3:.1f}",
            f"{outcome.psnr_db:.2f}",
            *("-" if db is None else f"{outcome.psnr_db - db:+.2f}" for db in same),
        )
    return table


def draw(found: Comparison, path: Path) -> None:
    """Draws PSNR over the share of the Gaussians, and over the bytes fetched."""
    figure = matplotlib.figure.Figure(figsize=(11, 5), layout="constrained")
    matplotlib.backends.backend_agg.FigureCanvasAgg(figure)
    shares, rates = figure.subplots(1, 2, sharey=True)
    draw_lines(shares, found, lambda outcome: 100 * outcome.share)
    draw_lines(rates, found, lambda outcome: outcome.bytes_per_frame / 1e3)
    shares.set_xlabel("share of the Gaussians of every slice, %")
    shares.set_ylabel("PSNR, dB, held-out cameras")
    names = ", ".join(outcome.name for outcome in found.of(BY_OPACITY))
    shares.set_title(f"dropped: one point each at {names}", fontsize=10)
    rates.set_xlabel("kB per frame; all bytes of a play from frame 0")
    rates.set_title("the same points; the kept Gaussians are coded again as a stream", fontsize=10)
    figure.suptitle(found.title, fontsize=11)
    handles, labels = shares.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, fontsize=9)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=120, metadata={"Software": None})


def draw_lines(
    axes: matplotlib.axes.Axes, found: Comparison, place: Callable[[Outcome], float]
) -> None:
    """Draws a line for each of STYLES; place: gives the x coordinate of a point."""
    for chosen, (colour, style, label) in STYLES.items():
        line = found.of(chosen)
        points = [(place(outcome), outcome.psnr_db) for outcome in line]
        axes.plot(*zip(*points, strict=True), style, color=colour, markersize=5, label=label)
        for outcome, point in zip(line, points, strict=True):
            if chosen == LAYERS:
                axes.annotate(
                    outcome.name, point, xytext=(-4, 6), textcoords="offset points", ha="right",
                    fontsize=8, color=colour,
                )  # fmt: skip
    axes.margins(x=0.12, y=0.12)
    axes.grid(alpha=0.3)


def draw_sheet(found: Comparison, path: Path) -> None:
    """Draws a row for each of STYLES, most Gaussians first; the captured picture comes last."""
    rows = [found.of(how) for how in STYLES]
    columns = max(len(rows[0]), len(rows[-1]) + 1)
    height_px, width_px = found.truth.shape[:2]
    cell_px = (SHEET_PX + GAP_PX) // columns
    size = cell_px - GAP_PX, round((cell_px - GAP_PX) * height_px / width_px)
    row_px = CAPTION_PX + size[1] + GAP_PX
    sheet = Image.new("RGB", (columns * cell_px - GAP_PX, len(rows) * row_px - GAP_PX), "black")
    pen = ImageDraw.Draw(sheet)
    font = ImageFont.load_default(13)

    def put(row: int, column: int, caption: str, picture: Bytes) -> None:
        left, top = column * cell_px, row * row_px
        pen.text((left + 2, top + CAPTION_PX // 2), caption, "white", font, anchor="lm")
        small = Image.fromarray(picture).resize(size, Image.Resampling.LANCZOS)
        sheet.paste(small, (left, top + CAPTION_PX))

    for row, line in enumerate(rows):
        for column, o in enumerate(line):
            what = f"{o.name}, {o.share:.0%}" if o.chosen == LAYERS else f"{o.name} {o.chosen}"
            caption = f"{what}: {o.bytes_per_frame / 1e3:.1f} kB/frame, {o.picture_db:.2f} dB"
            put(row, column, caption, o.picture)
    put(len(rows) - 1, columns - 1, f"as seen: {found.truth_name}", found.truth)
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as temporary:
        sheet.save(temporary, format="JPEG", quality=JPEG_QUALITY)


def run(config: DroppingConfig) -> None:
    found = measure(config)
    Console(width=110).print(table_of(found))
    draw(found, config.out)
    draw_sheet(found, config.sheet)


if __name__ == "__main__":
    description = "Drops Gaussians of a stream by rank, and by its layers."
    run_command(DroppingConfig, run, "scripts/bench dropping", description)
