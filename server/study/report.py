"""What a study leaves: a table of means, plays.csv with every play, and plays.png.

Rule: nothing in it says when or where it was made, so equal runs give equal numbers.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from dataclasses import asdict, fields
from pathlib import Path
from statistics import fmean

import matplotlib.backends.backend_agg
import matplotlib.figure
from matplotlib.axes import Axes
from rich import box
from rich.table import Table

from .choice import OWN
from .study import Play

COLUMNS = (
    ("QoE\ndB", "quality_db", 1, 2),
    ("PSNR\ndB", "psnr_db", 1, 2),
    ("5th %ile\ndB", "low_psnr_db", 1, 2),
    ("rebuf.\n%", "rebuffering", 100, 2),
    ("start\ns", "startup_s", 1, 2),
    ("stalls", "stalls", 1, 1),
    ("step\ndB", "step_db", 1, 3),
    ("layers", "layers", 1, 2),
)
"""Heading, field of a `Play`, factor, digits."""
DRAWN = (
    ("QoE (dB)", "quality_db", 1),
    ("mean PSNR (dB)", "psnr_db", 1),
    ("rebuffering (% of the time shown)", "rebuffering", 100),
)
"""Label, field of a `Play`, factor."""


def by_load(plays: Sequence[Play]) -> Iterator[tuple[str, list[Play]]]:
    """The plays at each load, in the order in which they come, and then all if there are more."""
    loads = list(dict.fromkeys(play.load for play in plays))
    for load in loads:
        yield f"{load:g}", [play for play in plays if play.load == load]
    if len(loads) > 1:
        yield "all", list(plays)


def by_policy(plays: Sequence[Play]) -> dict[str, list[Play]]:
    policies = dict.fromkeys(play.policy for play in plays)
    return {policy: [play for play in plays if play.policy == policy] for policy in policies}


def mean(plays: Sequence[Play], name: str) -> float:
    """Of the field `name`."""
    return fmean(getattr(play, name) for play in plays)


def table_of(plays: Sequence[Play]) -> Table:
    """The means of each policy at each load, in 80 characters."""
    count = len({play.trace for play in plays})
    table = Table(
        title=f"means over {count} traces", box=box.SIMPLE_HEAD, collapse_padding=True,
        pad_edge=False,
    )  # fmt: skip
    table.add_column("load", justify="right")
    table.add_column("policy", no_wrap=True)
    for heading, *_ in COLUMNS:
        table.add_column(heading, justify="right", no_wrap=True)
    for load, some in by_load(plays):
        for policy, own in by_policy(some).items():
            means = (
                f"{factor * mean(own, name):.{digits}f}" for _, name, factor, digits in COLUMNS
            )
            table.add_row(load, policy, *means, style="bold" if policy == OWN else None)
        table.add_section()
    return table


def write_plays(folder: Path, plays: Sequence[Play]) -> None:
    """Writes plays.csv and plays.png."""
    with (folder / "plays.csv").open("w", encoding="utf-8", newline="") as file:
        table = csv.DictWriter(file, [field.name for field in fields(Play)], lineterminator="\n")
        table.writeheader()
        table.writerows(map(asdict, plays))
    draw(plays).savefig(folder / "plays.png")


def draw(plays: Sequence[Play]) -> matplotlib.figure.Figure:
    """The plays of each policy as distribution functions, one column for each load."""
    columns = [(load, some) for load, some in by_load(plays) if load != "all"]
    figure = matplotlib.figure.Figure(
        figsize=(1.2 + 3.6 * len(columns), 0.8 + 2.8 * len(DRAWN)), layout="constrained"
    )
    matplotlib.backends.backend_agg.FigureCanvasAgg(figure)
    panels = figure.subplots(len(DRAWN), len(columns), squeeze=False)
    for row, (label, name, factor) in zip(panels, DRAWN, strict=True):
        row[0].set_ylabel("cumulative share of plays")
        for axes, (load, some) in zip(row, columns, strict=True):
            draw_distributions(axes, some, name, factor)
            axes.set_xlabel(label)
            axes.set_title(f"load {load}", fontsize=11)
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=4, frameon=False)
    return figure


def draw_distributions(axes: Axes, plays: Sequence[Play], name: str, factor: float) -> None:
    """The share of the plays that have at most so much of the field `name`."""
    for policy, own in by_policy(plays).items():
        values = [factor * getattr(play, name) for play in own]
        axes.ecdf(values, label=policy, linewidth=2.4 if policy == OWN else 1.2)
    axes.grid(color="#e4e4e4", linewidth=0.6)
