"""Policies over throughput traces, beside a bound that knows the link: the tables of
docs/RESULTS.md.

Usage: scripts/bench abr STREAM --traces DIR [--half report] [--per-folder 9]

Plays what swings-abr plays, with its options. `oracle` is an upper bound of QoE: no play reaches
more, even if it knows the link beforehand. Its PSNR is that of the same solution; its rebuffering
and start are those of layer 0 alone, which waits least. `norm.` is where the mean QoE lies between
that of layer 0 alone (0) and the oracle's (1). `ours ahead` is our QoE minus the other's on the
same trace at the same load, with the 95 % interval of a bootstrap over the traces.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from statistics import fmean
from typing import Annotated

from rich import box
from rich.console import Console
from rich.table import Table

from bench.abr.ahead import ahead_db
from bench.abr.bound import normalised
from bench.abr.oracle import Outcome, judge_plays
from codec.console import run_command
from codec.files import making_folder
from codec.progressline import counted
from server.study.choice import OWN
from server.study.config import POLICIES_OPTION, StudyConfig
from server.study.report import by_policy, mean, write_plays
from server.study.study import open_cases, over_cases

DYNAMIC = f"{Path(__file__).with_name('dynamic.py')}:Dynamic"
COLUMNS = (
    "load", "policy", "QoE\ndB", "norm.", "ours ahead\ndB", "PSNR\ndB", "rebuf.\n%", "layers",
    "start\ns", "stalls",
)  # fmt: skip
LEAST_WIDTH = 100
"""Columns of a terminal that the table needs."""


@dataclass(frozen=True, slots=True)
class ComparisonConfig(StudyConfig):
    """The plays to compare."""

    policy: Annotated[tuple[str, ...], POLICIES_OPTION] = (
        "throughput", "bola", DYNAMIC, "robust_mpc", "tail_drop", OWN,
    )  # fmt: skip
    """Policies to compare, separated by commas."""


def add_rows(table: Table, load: str, outcomes: Sequence[Outcome], seed: int) -> None:
    """The policies, and the oracle, over the cases of one load or of all."""
    oracles = [outcome.oracle for outcome in outcomes]
    base_db = fmean(oracle.base_db for oracle in oracles)
    bound_db = fmean(oracle.quality_db for oracle in oracles)
    plays = by_policy([play for outcome in outcomes for play in outcome.plays])
    for policy, own in plays.items():
        quality_db, lead = mean(own, "quality_db"), ""
        share = normalised(quality_db, base_db, bound_db)
        if OWN in plays and policy != OWN:
            found = ahead_db(plays[OWN], own, seed)
            lead = f"{found.mean:+.2f} ({found.low:+.2f}..{found.high:+.2f})"
        table.add_row(
            load,
            policy,
            f"{quality_db:.2f}",
            "" if math.isnan(share) else f"{share:.3f}",
            lead,
            f"{mean(own, 'psnr_db'):.2f}",
            f"{100 * mean(own, 'rebuffering'):.2f}",
            f"{mean(own, 'layers'):.2f}",
            f"{mean(own, 'startup_s'):.2f}",
            f"{mean(own, 'stalls'):.1f}",
            style="bold" if policy == OWN else None,
        )
    table.add_row(
        load,
        "oracle",
        f"{bound_db:.2f}",
        "1",
        "",
        f"{fmean(oracle.psnr_db for oracle in oracles):.2f}",
        f"{100 * fmean(oracle.rebuffering for oracle in oracles):.2f}",
        "",
        f"{fmean(oracle.startup_s for oracle in oracles):.2f}",
        "",
        style="dim",
        end_section=True,
    )


def run(config: ComparisonConfig) -> None:
    media, cases = open_cases(config)
    work = partial(judge_plays, media, config.rules, config.policy)
    with counted("simulating") as progress:
        outcomes = over_cases(work, cases, config.jobs, progress)
    if config.out is not None:
        with making_folder(config.out) as folder:
            write_plays(folder, [play for outcome in outcomes for play in outcome.plays])
    count = len(cases) // len(config.loads)
    table = Table(
        title=f"means over {count} traces", box=box.SIMPLE_HEAD, collapse_padding=True,
        pad_edge=False,
    )  # fmt: skip
    for name in COLUMNS:
        table.add_column(name, justify="left" if name == "policy" else "right", no_wrap=True)
    for number, load in enumerate(config.loads):
        some = outcomes[number * count : (number + 1) * count]
        add_rows(table, f"{load:g}", some, config.seed)
    if len(config.loads) > 1:
        add_rows(table, "all", outcomes, config.seed)
    console = Console()
    console.width = max(console.width, LEAST_WIDTH)
    console.print(table)


def main() -> None:
    run_command(
        ComparisonConfig, run, "scripts/bench abr", "Compares policies with what a link can give."
    )


if __name__ == "__main__":
    main()
