"""The price of layers: each number of layers of a stream beside a stream of one layer with as many
bytes, which was trained to be shown whole.

Usage: scripts/bench ladder CAPTURE --out docs/ladder.png

For each rung, the first 1, 2, ... layers, and each of --active-shares, num_gs of a dedicated
stream is searched until its bytes are those of the rung within 5 %. All streams are scored from
their decoded files on the held-out cameras; bytes are all that a player starting at frame 0
fetches.
BD-PSNR and BD-rate are the area between the ladder and the best of the dedicated streams. What no
option names is that of preset `fine`. Finished runs are kept in --work, as by
`scripts/bench ablate`.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

os.environ.setdefault("OMP_WAIT_POLICY", "passive")

import matplotlib.backends.backend_agg
import matplotlib.figure
import matplotlib.ticker
import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from bench.ablate import Outcome, Setting, TrialsConfig, measure
from bench.bjontegaard import RatePoint, bd_psnr_db, bd_rate, rising
from codec.console import run_command
from codec.errors import InvalidError
from trainer.fit.config import FitConfig
from trainer.run.config import PRESETS

FINE = PRESETS["fine"](Path("capture"), Path("stream"))

LADDER, DEDICATED = "ladder", "dedicated"
COLOURS = {LADDER: "#1f5fbf", DEDICATED: "#d9480f"}

TOLERANCE = 0.05
"""How far a dedicated stream's bytes may be from those of its rung, of 1."""

TRIES = 4
"""Dedicated streams that are trained for a rung and an active share, at most."""

BYTES_EXPONENT = 0.9
"""Power of num_gs with which the bytes grow, until two streams say better."""


@dataclass(frozen=True)
class LadderConfig(TrialsConfig):
    """Compares each number of layers of a stream with a stream of one layer of as many bytes."""

    out: Path = Path("docs/ladder.png")
    """The plot to write."""
    seeds: int = 1
    """Runs of each stream, one per seed; points are their means."""
    num_gs: int = 12_000
    """Gaussians active in a frame of the stream with layers."""
    settle_rounds: int = 15
    """Settle rounds of genesis."""
    window_iterations: int = 800
    """Iterations of every later window."""
    layers: tuple[float, ...] = FINE.layers
    """Share of the Gaussians in each layer."""
    active_shares: tuple[float, ...] = (0.2, 0.3)
    """Shares of a slice's slots that the dedicated streams may train and send; that of the stream
    with layers is the preset's."""

    def base(self) -> FitConfig:
        """The settings that all streams share."""
        return replace(
            FINE.fit,
            num_gs=self.num_gs,
            genesis_iterations=self.genesis_iterations,
            settle_rounds=self.settle_rounds,
            window_iterations=self.window_iterations,
        )


@dataclass(frozen=True, slots=True)
class Rung:
    """A stream at one number of layers; means over the seeds."""

    num_gs: int
    active_share: float
    point: RatePoint


def rungs_of(setting: Setting, outcomes: Sequence[Outcome]) -> list[Rung]:
    """The rungs of a stream, fewest layers first."""
    rates = np.mean([o.layers_bytes for o in outcomes], axis=0)
    psnrs_db = np.mean([o.layers_db for o in outcomes], axis=0)
    sizes = np.rint(np.cumsum(setting.layers) * setting.fit.num_gs).astype(int)
    return [
        Rung(int(size), setting.fit.lease.active_share, RatePoint(float(rate), float(psnr_db)))
        for size, rate, psnr_db in zip(sizes, rates, psnrs_db, strict=True)
    ]


def next_size(tried: Mapping[int, float], wanted_bytes: float) -> int:
    """The num_gs to try for a rate, by the rates of those `tried`: the bytes are taken for a power
    of num_gs."""
    nearest = sorted(tried, key=lambda n: abs(math.log(tried[n] / wanted_bytes)))
    power = BYTES_EXPONENT
    if len(nearest) > 1:
        one, other = nearest[:2]
        slope = math.log(tried[one] / tried[other]) / math.log(one / other)
        power = min(max(slope, BYTES_EXPONENT / 2), 2 * BYTES_EXPONENT)
    factor = math.pow(wanted_bytes / tried[nearest[0]], 1 / power)
    return max(round(nearest[0] * factor), 1)


def search(config: LadderConfig, ladder: Sequence[Rung]) -> list[Rung]:
    """The dedicated streams that were trained, those of each active share in turn."""
    found: list[Rung] = []
    for share in config.active_shares:
        tried: dict[int, float] = {}
        for rung in ladder:
            wanted = rung.point.bytes_per_frame
            for _ in range(TRIES):
                if any(abs(rate / wanted - 1) <= TOLERANCE for rate in tried.values()):
                    break
                size = next_size(tried, wanted) if tried else rung.num_gs
                if size in tried:
                    break
                base = config.base()
                fit = replace(base, num_gs=size, lease=replace(base.lease, active_share=share))
                name = f"{size:,} Gaussians, active share {share:g}"
                setting = Setting(DEDICATED, name, fit, layers=(1.0,))
                (one,) = rungs_of(setting, measure(config, [setting])[setting])
                tried[size] = one.point.bytes_per_frame
                found.append(one)
    return found


def points_of(rungs: Sequence[Rung]) -> list[RatePoint]:
    return [rung.point for rung in rungs]


def table_of(ladder: Sequence[Rung], dedicated: Sequence[Rung]) -> Table:
    """A row for each rung and, below them, for each dedicated stream, fewest bytes first."""
    table = Table(box=box.MARKDOWN)
    for name in ("layers", "Gaussians", "active share", "kB a frame", "PSNR dB"):
        table.add_column(name, justify="right")
    by_bytes = sorted(dedicated, key=lambda rung: rung.point.bytes_per_frame)
    layered = [(str(count), rung) for count, rung in enumerate(ladder, start=1)]
    for told, rung in (*layered, *((DEDICATED, rung) for rung in by_bytes)):
        table.add_row(
            told,
            f"{rung.num_gs:,}",
            f"{rung.active_share:g}",
            f"{rung.point.bytes_per_frame / 1e3:.1f}",
            f"{rung.point.psnr_db:.2f}",
        )
    return table


def verdict(ladder: Sequence[Rung], dedicated: Sequence[Rung]) -> str:
    """The area between the curves, in one line."""
    points, base = points_of(ladder), points_of(dedicated)
    gain_db, rate = bd_psnr_db(points, base), bd_rate(points, base)
    first = "no rate in common" if gain_db is None else f"BD-PSNR {gain_db:+.2f} dB"
    second = "no PSNR in common" if rate is None else f"BD-rate {rate:+.1%}"
    return f"{first}, {second}"


def draw(ladder: Sequence[Rung], dedicated: Sequence[Rung], config: LadderConfig) -> None:
    figure = matplotlib.figure.Figure(figsize=(8, 5.2), layout="constrained")
    matplotlib.backends.backend_agg.FigureCanvasAgg(figure)
    axes = figure.subplots()
    for name, rungs in ((LADDER, ladder), (DEDICATED, dedicated)):
        line = rising(points_of(rungs)) if name == DEDICATED else points_of(rungs)
        axes.plot(
            [p.bytes_per_frame / 1e3 for p in line], [p.psnr_db for p in line], "-",
            color=COLOURS[name], linewidth=1.3,
        )  # fmt: skip
        axes.plot(
            [r.point.bytes_per_frame / 1e3 for r in rungs], [r.point.psnr_db for r in rungs], "o",
            color=COLOURS[name], markersize=5,
            label="layers of one stream" if name == LADDER else "a stream of one layer each",
        )  # fmt: skip
        for count, rung in enumerate(rungs, start=1):
            axes.annotate(
                f"{count}" if name == LADDER else f"{rung.num_gs:,} x {rung.active_share:g}",
                (rung.point.bytes_per_frame / 1e3, rung.point.psnr_db),
                xytext=(6, -11) if name == LADDER else (-6, 7), textcoords="offset points",
                ha="left" if name == LADDER else "right", fontsize=8, color=COLOURS[name],
            )  # fmt: skip
    axes.set_xscale("log")
    axes.xaxis.set_major_locator(matplotlib.ticker.LogLocator(subs=(1, 1.5, 2, 3, 5, 7)))
    axes.xaxis.set_major_formatter(matplotlib.ticker.FormatStrFormatter("%g"))
    axes.xaxis.set_minor_formatter(matplotlib.ticker.NullFormatter())
    axes.set_xlabel("kB per frame, logarithmic; all bytes of a play from frame 0")
    axes.set_ylabel("PSNR, dB, held-out cameras")
    axes.margins(x=0.15, y=0.15)
    axes.grid(alpha=0.3)
    axes.legend(fontsize=9, loc="lower right")
    axes.set_title(
        f"{config.capture.resolve().name} at {config.scale:g}, frames {config.frames}: "
        f"{verdict(ladder, dedicated)}",
        fontsize=10,
    )
    config.out.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(config.out, dpi=120, metadata={"Software": None})


def run(config: LadderConfig) -> None:
    if config.seeds < 1 or len(config.layers) < 2 or not config.active_shares:
        raise InvalidError("give at least one seed, two layers and one of active-shares")
    layered = Setting(LADDER, LADDER, config.base(), layers=config.layers)
    ladder = rungs_of(layered, measure(config, [layered])[layered])
    dedicated = search(config, ladder)
    console = Console(width=100)
    console.print(table_of(ladder, dedicated))
    console.print(verdict(ladder, dedicated), highlight=False)
    draw(ladder, dedicated, config)


if __name__ == "__main__":
    run_command(LadderConfig, run, "scripts/bench ladder", "Compares layers with streams.")
