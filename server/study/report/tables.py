"""The table of a report, for a terminal and for a page."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from rich import box
from rich.console import JustifyMethod
from rich.table import Table

from .bootstrap import Interval
from .summary import OWN, LoadSummary, PolicySummary

HEAD = (
    "load",
    "policy",
    "QoE (dB)",
    "normalised",
    "ours ahead (dB)",
    "PSNR (dB)",
    "5th percentile (dB)",
    "rebuffering (%)",
    "start-up (s)",
    "stalls",
    "step (dB)",
    "layers",
    "wasted (%)",
)
SHORT = {
    "load": "load",
    "policy": "policy",
    "QoE (dB)": "QoE\ndB",
    "normalised": "norm.",
    "ours ahead (dB)": "ours ahead\ndB",
    "PSNR (dB)": "PSNR\ndB",
    "rebuffering (%)": "rebuf.\n%",
    "layers": "layers",
}
"""The columns of HEAD that a terminal shows, with their short names."""
ORACLE = "oracle"


def rows(summaries: Sequence[LoadSummary]) -> Iterator[tuple[str, ...]]:
    """The cells under HEAD; of the oracle some are empty."""
    for summary in summaries:
        load = "all" if summary.load is None else f"{summary.load:g}"
        yield from (_row(load, standing) for standing in summary.standings)
        yield (
            load,
            ORACLE,
            f"{summary.bound_db:.2f}",
            "1",
            "",
            f"{summary.bound_psnr_db:.2f}",
            "",
            f"{100 * summary.base_rebuffering:.2f}",
            f"{summary.base_startup_s:.2f}",
            *[""] * 4,
        )


def _row(load: str, one: PolicySummary) -> tuple[str, ...]:
    return (
        load,
        one.policy,
        f"{one.quality_db:.2f}",
        "" if math.isnan(one.normalised) else f"{one.normalised:.3f}",
        "" if one.behind is None else interval_text(one.behind),
        f"{one.psnr_db:.2f}",
        f"{one.low_psnr_db:.2f}",
        f"{100 * one.rebuffering:.2f}",
        f"{one.startup_s:.2f}",
        f"{one.stalls:.1f}",
        f"{one.step_db:.3f}",
        f"{one.layers:.2f}",
        f"{100 * one.wasted:.2f}",
    )


def interval_text(interval: Interval) -> str:
    return f"{interval.mean:+.2f} ({interval.low:+.2f}..{interval.high:+.2f})"


def terminal_table(summaries: Sequence[LoadSummary]) -> Table:
    """The columns that fit into 80 characters."""
    table = Table(
        title=f"means over {summaries[0].plays} traces",
        box=box.SIMPLE_HEAD,
        collapse_padding=True,
        pad_edge=False,
    )
    for name in SHORT:
        justify: JustifyMethod = "left" if name == "policy" else "right"
        table.add_column(SHORT[name], justify=justify, no_wrap=True)
    places = [HEAD.index(name) for name in SHORT]
    before = ""
    for row in rows(summaries):
        if before not in ("", row[0]):
            table.add_section()
        before = row[0]
        style = "bold" if row[1] == OWN else "dim" if row[1] == ORACLE else None
        table.add_row(*(row[place] for place in places), style=style)
    return table
