"""The pictures of a report: distributions, paired differences, and plays over time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import matplotlib.backends.backend_agg
import matplotlib.figure
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from server.study.plays import Oracle, Outcome, Play

from .summary import OWN, LoadSummary
from .timecourse import Points, TimeLine

COLOURS = ("#7a5195", "#2a78b5", "#4aa8a0", "#c98a1b", "#8a8a8a", "#9c4f8a", "#5b7f34")
"""Colours of the policies but ours, in their order; then from the first again, dashed."""
OWN_COLOUR = "#c3321f"
ORACLE_COLOUR = "#000000"
LINK_COLOUR = "#9fb8c9"
STALL_COLOUR = "#f3c7bf"
LEAST_SHARE_DRAWN = 0.04
"""Where a few plays are far worse than all others, the axis leaves these out."""


def policy_style(policy: str, policies: Sequence[str]) -> dict[str, Any]:
    """How the line of a policy is drawn."""
    if policy == OWN:
        return {"color": OWN_COLOUR, "linewidth": 2.2, "zorder": 5}
    number = [name for name in policies if name != OWN].index(policy)
    dash = "-" if number < len(COLOURS) else "--"
    return {"color": COLOURS[number % len(COLOURS)], "linewidth": 1.4, "linestyle": dash}


def load_title(load: float | None) -> str:
    return "all loads" if load is None else f"load {load:g}"


def _figure(width: float, height: float) -> matplotlib.figure.Figure:
    """Inches."""
    figure = matplotlib.figure.Figure(
        figsize=(width, height), dpi=100, facecolor="white", layout="constrained"
    )
    matplotlib.backends.backend_agg.FigureCanvasAgg(figure)
    return figure


def _plain(axes: Axes) -> None:
    axes.grid(color="#e4e4e4", linewidth=0.6)
    axes.set_axisbelow(True)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


_Drawn = tuple[str, Callable[[Play, Oracle], float], Callable[[Oracle], float]]
_DRAWN: tuple[_Drawn, ...] = (
    ("QoE (dB)", lambda play, _: play.quality_db, lambda oracle: oracle.quality_db),
    (
        "QoE minus oracle QoE (dB)",
        lambda play, oracle: play.quality_db - oracle.quality_db,
        lambda _: 0.0,
    ),
    ("mean PSNR (dB)", lambda play, _: play.psnr_db, lambda oracle: oracle.psnr_db),
    (
        "rebuffering (% of the time shown)",
        lambda play, _: 100 * play.rebuffering,
        lambda oracle: 100 * oracle.rebuffering,
    ),
)


def draw_distributions(outcomes: Sequence[Outcome]) -> matplotlib.figure.Figure:
    """QoE, PSNR and rebuffering of the plays of each policy as distribution functions, one column
    for each load. Links differ more than policies do, so QoE is also drawn beside the oracle's."""
    loads = list(dict.fromkeys(outcome.load for outcome in outcomes))
    policies = [play.policy for play in outcomes[0].plays]
    figure = _figure(1.2 + 3.6 * len(loads), 0.8 + 2.8 * len(_DRAWN))
    panels = figure.subplots(len(_DRAWN), len(loads), squeeze=False)
    for row, (label, of_play, of_oracle) in zip(panels, _DRAWN, strict=True):
        for axes, load in zip(row, loads, strict=True):
            cases = [outcome for outcome in outcomes if outcome.load == load]
            best = [of_oracle(one.oracle) for one in cases]
            _distribution(axes, best, label="oracle", color=ORACLE_COLOUR, linestyle=":")
            values = list(best)
            for number, policy in enumerate(policies):
                of_policy = [of_play(one.plays[number], one.oracle) for one in cases]
                _distribution(axes, of_policy, label=policy, **policy_style(policy, policies))
                values += of_policy
            _limit(axes, sorted(values), is_share=label.startswith("rebuffering"))
            axes.set_xlabel(label)
            axes.xaxis.set_major_locator(MaxNLocator(6))
            axes.set_ylim(0, 1.02)
            _plain(axes)
        row[0].set_ylabel("cumulative share of plays")
    for axes, load in zip(panels[0], loads, strict=True):
        axes.set_title(load_title(load), fontsize=11)
    handles, labels = panels[0, 0].get_legend_handles_labels()
    columns = min(len(labels), 1 + 3 * len(loads))
    figure.legend(handles, labels, loc="outside upper center", ncols=columns, frameon=False)
    return figure


def _distribution(axes: Axes, values: Sequence[float], **style: Any) -> None:
    ordered = sorted(values)
    shares = [(n + 1) / len(ordered) for n in range(len(ordered))]
    axes.step([ordered[0], *ordered], [0.0, *shares], where="post", **style)


def _limit(axes: Axes, ordered: Sequence[float], is_share: bool) -> None:
    """Lets a few plays that went wrong not squeeze all others into a line."""
    skipped = int(LEAST_SHARE_DRAWN * len(ordered))
    if is_share:
        high = ordered[-1 - skipped]
        axes.set_xlim(-0.02 * max(high, 1.0), 1.05 * max(high, 1.0))
        return
    low, high = ordered[skipped], ordered[-1]
    margin = 0.04 * max(high - low, 0.1)
    axes.set_xlim(low - margin, high + margin)


def draw_differences(summaries: Sequence[LoadSummary]) -> matplotlib.figure.Figure | None:
    """How far ours is ahead of each policy; None where there is nothing to compare."""
    behind = [
        [(one.policy, one.behind) for one in summary.standings if one.behind is not None]
        for summary in summaries
    ]
    if not behind[0]:
        return None
    policies = [one.policy for one in summaries[0].standings]
    figure = _figure(1.2 + 2.9 * len(summaries), 1.4 + 0.38 * len(behind[0]))
    panels = figure.subplots(1, len(summaries), sharey=True, squeeze=False)[0]
    for axes, summary, rows in zip(panels, summaries, behind, strict=True):
        for place, (policy, interval) in enumerate(reversed(rows)):
            colour = policy_style(policy, policies)["color"]
            axes.plot([interval.low, interval.high], [place, place], color=colour, linewidth=3)
            axes.plot([interval.mean], [place], "o", color=colour, markersize=7)
        axes.axvline(0, color="black", linewidth=1)
        axes.set_yticks(range(len(rows)), [policy for policy, _ in reversed(rows)])
        axes.set_ylim(-0.6, len(rows) - 0.4)
        axes.set_title(load_title(summary.load), fontsize=11)
        axes.set_xlabel(f"QoE of {OWN} minus the other's (dB)")
        _plain(axes)
    return figure


def draw_time_lines(lines: Sequence[TimeLine]) -> matplotlib.figure.Figure:
    """Plays beside each other: link and estimate, layers shown, lead."""
    figure = _figure(1.2 + 5.4 * len(lines), 7.2)
    panels = figure.subplots(3, len(lines), sharex=True, sharey="row", squeeze=False)
    most_bps = max(rate for line in lines for _, rate in line.link_bps)
    for (rates, layers, leads), line in zip(panels.T, lines, strict=True):
        end_s = line.layers[-1][0]
        rates.stairs(
            [rate / 1e6 for _, rate in line.link_bps],
            [*(time_s for time_s, _ in line.link_bps), end_s],
            fill=True,
            color=LINK_COLOUR,
            label="link",
        )
        _draw_points(rates, line.estimate_bps, 1e-6, color=OWN_COLOUR, label="estimate")
        _draw_points(layers, line.layers, 1.0, color="#33307a")
        _draw_points(leads, line.lead_s, 1.0, color="#2fa58a")
        for axes in (rates, layers, leads):
            for n, (begin_s, until_s) in enumerate(line.stalls_s):
                label = "nothing to show" if n == 0 else None
                axes.axvspan(begin_s, until_s, color=STALL_COLOUR, linewidth=0, label=label)
            _plain(axes)
        rates.set_title(line.policy, fontsize=11)
        leads.set_xlabel("time (s)")
        leads.set_xlim(0, max(one.layers[-1][0] for one in lines))
    # An estimate of the first moments may be far off.
    panels[0, 0].set_ylim(0, 1.15e-6 * most_bps)
    panels[1, 0].set_ylim(bottom=0)
    panels[2, 0].set_ylim(bottom=0)
    panels[0, 0].set_ylabel("rate (Mbit/s)")
    panels[1, 0].set_ylabel("layers shown")
    panels[2, 0].set_ylabel("buffer (s of video)")
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper right", ncols=len(labels), frameon=False)
    case = lines[0].case
    figure.suptitle(
        f"{case.trace}, {load_title(case.load)}", x=0.01, ha="left", fontsize=11, parse_math=False
    )
    return figure


def _draw_points(axes: Axes, points: Points, unit: float, **style: Any) -> None:
    times_s = [time_s for time_s, _ in points]
    values = [unit * value for _, value in points]
    axes.step(times_s, values, where="post", linewidth=1.4, **style)
