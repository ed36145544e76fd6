"""Effect of the choices for slots that last: leases off and on, the active share, prediction, and
the other settings.

Usage: scripts/bench leases CAPTURE --out docs/leases.png

One choice is changed at a time. Every setting is trained once per seed and scored from its decoded
files on the held-out cameras; finished runs are kept as JSON in --work, like those of
`scripts/bench ablate`. "kB a frame" is the size of a slice, skip map and changes: the stream's rate
in the long run. "frame 0 kB" is the size of the keyframes of frame 0. "unpredicted" is the size of
the same slices if every Gaussian that they send were coded by itself, as a new one."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

os.environ.setdefault("OMP_WAIT_POLICY", "passive")

import matplotlib.axes
import matplotlib.backends.backend_agg
import matplotlib.figure
import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from bench.ablate import Outcomes, Setting, TrialsConfig, mean, measure, spread
from bench.recordedupdates import recorded_update
from codec.console import run_command
from codec.errors import InvalidError
from codec.slots.encoder import SlotEncoder
from codec.slots.slotlayout import NEW, PREDICTED
from codec.stream import StreamReader
from codec.stream.manifest import SKIP_MAPS
from codec.stream.segment import encode_packet
from trainer.fit.config import FitConfig

COLOURS = ("#1f5fbf", "#d9480f", "#2b8a3e", "#862e9c", "#0b7285", "#a61e4d", "#5c940d", "#b8860b")
"""Colours of the choices."""
CHOSEN = "as chosen"
"""Name of the base setting, of which every other changes one choice."""
NO_LEASES = ", no leases"


@dataclass(frozen=True)
class LeasesConfig(TrialsConfig):
    """Trains a capture with one choice changed at a time; tabulates and draws the
    results."""

    seeds: int = 1
    """Runs of each setting, by seed; their spread shows which differences are significant."""
    out: Path = Path("docs/leases.png")
    """The plot to write."""
    num_gs: int = 10_000
    """Gaussians active in a frame, unless this is the changed choice."""
    settle_rounds: int = 6
    """Settle rounds of genesis, unless this is the changed choice."""
    active_shares: tuple[float, ...] = (1.0, 0.5, 0.15)
    """Share of a slice that is trained and sent; 1 switches leases off."""
    swin_sizes: tuple[int, ...] = (2, 5)
    """Frames that a lease lasts."""
    sizes: tuple[int, ...] = (5_000, 20_000)
    """Gaussians active in a frame."""
    settlings: tuple[int, ...] = (0, 12)
    """Settle rounds of genesis."""
    together_shares: tuple[float, ...] = (0.0,)
    """Share of a window in which all Gaussians of a large cell move as one."""
    prefix_shares: tuple[float, ...] = (0.0, 0.3)
    """Share of a later window's iterations that render only the first layers."""
    settle_prefix_shares: tuple[float, ...] = (0.0, 0.5)
    """Share of the iterations that render only the first layers while genesis settles."""
    holds: tuple[float, ...] = (0.5, 1.5)
    """Error of a value, in quantisation steps, from which it is sent."""


def settings(config: LeasesConfig) -> list[Setting]:
    """The base setting, then each choice with its other values."""
    base = FitConfig(
        num_gs=config.num_gs,
        genesis_iterations=config.genesis_iterations,
        settle_rounds=config.settle_rounds,
        window_iterations=config.window_iterations,
    )

    def lease(**changed: float) -> FitConfig:
        return replace(base, lease=replace(base.lease, **changed))

    choices: dict[str, dict[float, FitConfig]] = {
        "active_share": {share: lease(active_share=share) for share in config.active_shares},
        "swin_size": {size: replace(base, swin_size=size) for size in config.swin_sizes},
        "num_gs": {size: replace(base, num_gs=size) for size in config.sizes},
        "settle_rounds": {n: replace(base, settle_rounds=n) for n in config.settlings},
        "together_share": {s: replace(base, together_share=s) for s in config.together_shares},
        "prefix_share": {s: replace(base, prefix_share=s) for s in config.prefix_shares},
        "settle_prefix_share": {
            s: replace(base, settle_prefix_share=s) for s in config.settle_prefix_shares
        },
        "hold": {steps: lease(hold=steps) for steps in config.holds},
    }
    found = [Setting(CHOSEN, CHOSEN, base)]
    for choice, values in choices.items():
        for value, fit in values.items():
            name = f"{choice} {value:,g}"
            if fit.lease.active_share == 1:
                name += NO_LEASES
            if all(fit != other.fit for other in found):
                found.append(Setting(choice, name, fit))
    return found


def recoded(reader: StreamReader, predicts: bool = False) -> Iterator[list[bytes]]:
    """The packets of each slice from frame 1 on, skip map first: unchanged, or with every predicted
    Gaussian coded as new."""
    manifest = reader.manifest
    decoder = reader.decoder_at(0, manifest.num_layers)
    for birth in range(1, reader.num_frames):
        skip_map, *changes = (
            reader.read_object(manifest.segment_of(birth), part).content(birth)
            for part in (SKIP_MAPS, *range(manifest.num_layers))
        )
        encoder = SlotEncoder.resumed(decoder)
        statuses = decoder.statuses(birth, skip_map, changes)
        decoder.apply(birth, skip_map, changes)
        update = recorded_update(decoder, birth, statuses)
        if not predicts:
            statuses = np.where(statuses == PREDICTED, NEW, statuses).astype(np.uint8)
            update = replace(update, statuses=statuses)
        encoded = encoder.encode(update)
        assert encoded is not None  # nothing is born before frame 0 here
        yield [encode_packet(chunk) for chunk in (encoded.skip_map, *encoded.changes)]


def examine(reader: StreamReader) -> dict[str, float]:
    """Bytes of a slice without prediction, and bytes of the keyframes of frame 0."""
    without = [sum(map(len, packets)) for packets in recoded(reader)]
    return {
        "unpredicted_bytes": sum(without) / max(len(without), 1),
        "first_bytes": sum(reader.records[0].side_bytes[1:]),
    }


def table_of(outcomes: Outcomes) -> Table:
    """Means over the seeds; differences are to the chosen setting, seed by seed."""
    table = Table(box=box.MARKDOWN)
    table.add_column("setting", no_wrap=True)
    for name in (
        "PSNR dB", "dB to chosen", "moving dB", "flicker", "kB a frame", "unpredicted",
        "frame 0 kB", "dB of 1, 2, ... layers", "seconds",
    ):  # fmt: skip
        table.add_column(name, justify="right")
    chosen = next(iter(outcomes.values()))
    for setting, found in outcomes.items():
        gains_db = [o.psnr_db - c.psnr_db for o, c in zip(found, chosen, strict=True)]
        layers_db = np.mean([o.layers_db for o in found], axis=0)
        table.add_row(
            setting.name,
            spread([o.psnr_db for o in found], ".2f"),
            "-" if found is chosen else spread(gains_db, "+.2f"),
            known_mean([o.moving_db for o in found], ".2f"),
            known_mean([o.flicker for o in found], ".3f"),
            f"{mean([o.bytes_per_frame for o in found]) / 1e3:.1f}",
            f"{mean([o.more['unpredicted_bytes'] for o in found]) / 1e3:.1f}",
            f"{mean([o.more['first_bytes'] for o in found]) / 1e3:.1f}",
            " ".join(f"{db:.1f}" for db in layers_db[:-1]),
            f"{mean([o.seconds for o in found]):.0f}",
        )
    return table


def known_mean(values: Sequence[float | None], form: str) -> str:
    """Formatted mean of the values that are known; "-" if none is."""
    known = [value for value in values if value is not None]
    return format(mean(known), form) if known else "-"


def draw(outcomes: Outcomes, config: LeasesConfig) -> None:
    figure = matplotlib.figure.Figure(figsize=(11, 5.4), layout="constrained")
    matplotlib.backends.backend_agg.FigureCanvasAgg(figure)
    rates, layers = figure.subplots(1, 2, width_ratios=(3, 2))
    draw_rates(rates, outcomes)
    draw_layers(layers, outcomes)
    for axes in (rates, layers):
        axes.set_ylabel("PSNR, dB, held-out cameras")
        axes.margins(x=0.12, y=0.12)
        axes.grid(alpha=0.3)
    seeds = f", mean of {config.seeds} seeds" if config.seeds > 1 else ""
    figure.suptitle(
        f"{config.capture.resolve().name} at {config.scale:g}, frames {config.frames}, "
        f"{config.genesis_iterations:,} + {config.settle_rounds} times "
        f"{config.window_iterations:,}, then {config.window_iterations:,} iterations{seeds}",
        fontsize=11,
    )
    handles, names = rates.get_legend_handles_labels()
    figure.legend(handles, names, loc="outside lower center", ncols=4, fontsize=9)
    config.out.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(config.out, dpi=120, metadata={"Software": None})


def draw_rates(axes: matplotlib.axes.Axes, outcomes: Outcomes) -> None:
    """Draws a point for each setting; a line joins those of a choice with the base setting."""
    points = {
        setting: (mean([o.bytes_per_frame for o in found]) / 1e3, mean([o.psnr_db for o in found]))
        for setting, found in outcomes.items()
    }
    chosen = next(iter(outcomes))
    for number, group in enumerate(dict.fromkeys(s.group for s in outcomes)):
        mine = [setting for setting in outcomes if setting.group == group]
        colour = "black" if group == CHOSEN else COLOURS[(number - 1) % len(COLOURS)]
        line = sorted(points[setting] for setting in {chosen, *mine})
        axes.plot(
            *zip(*line, strict=True), "-", color=colour, linewidth=1, zorder=1 + (group == CHOSEN)
        )
        axes.plot(
            *zip(*(points[setting] for setting in mine), strict=True), "o", color=colour,
            markersize=6, label=group, zorder=3,
        )  # fmt: skip
        for setting in mine:
            axes.annotate(
                setting.name.removeprefix(group).removesuffix(NO_LEASES), points[setting],
                xytext=(5, 4), textcoords="offset points", fontsize=8, color=colour,
            )  # fmt: skip
    axes.set_xlabel("kB a frame after frame 0")
    axes.set_title("one point per setting", fontsize=10)


def draw_layers(axes: matplotlib.axes.Axes, outcomes: Outcomes) -> None:
    """Draws PSNR over the number of layers: the effect of training on the first layers."""
    for setting, found in outcomes.items():
        if setting.group not in (CHOSEN, "prefix_share", "settle_prefix_share"):
            continue
        y_db = np.mean([o.layers_db for o in found], axis=0)
        x = range(1, len(y_db) + 1)
        axes.plot(x, y_db, "-o", markersize=4, linewidth=1.2, label=setting.name)
    axes.legend(fontsize=8)
    axes.set_xticks(range(1, 1 + len(next(iter(outcomes.values()))[0].layers_db)))
    axes.set_xlabel("layers")
    axes.set_title("with the first layers only", fontsize=10)


def run(config: LeasesConfig) -> None:
    if config.seeds < 1:
        raise InvalidError("give at least one seed")
    outcomes = measure(config, settings(config), examine)
    Console(width=150).print(table_of(outcomes))
    draw(outcomes, config)


if __name__ == "__main__":
    run_command(
        LeasesConfig, run, "scripts/bench leases", "Compares the choices for slots that last."
    )
