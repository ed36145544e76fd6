"""The pictures of `--plot`: network, layers and buffer over a play, with what stood still marked,
and what each frame's time went into.
"""

from __future__ import annotations

import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import matplotlib.backends.backend_agg
import matplotlib.figure
import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from codec.files import write_atomic

from .stages import STAGES, StageProfile

LINK_COLOUR, GOODPUT_COLOUR = "#a8a8a8", "#2a78b5"
LAYERS_COLOUR, BUFFER_COLOUR = "#33307a", "#2fa58a"
STALL_COLOUR, START_COLOUR = "#d8452e", "#f0d9a8"
MAX_TITLE_CHARS = 60

Json = dict[str, Any]


def write_plot(path: Path, report: Json) -> None:
    """Draws the report of `PlaySummary.to_json` into a PNG; the file is whole or absent."""
    figure = draw_report(report)
    picture = io.BytesIO()
    matplotlib.backends.backend_agg.FigureCanvasAgg(figure)
    figure.savefig(picture, format="png")
    write_atomic(path, picture.getvalue())


def draw_report(report: Json) -> matplotlib.figure.Figure:
    figure = matplotlib.figure.Figure(figsize=(10, 6.4), dpi=120, layout="constrained")
    network, layers, buffer = figure.subplots(
        3, 1, sharex=True, gridspec_kw={"height_ratios": (3, 2, 2)}
    )
    totals = report["totals"]
    name = report["source"]
    name = name if len(name) <= MAX_TITLE_CHARS else f"...{name[-MAX_TITLE_CHARS:]}"
    plays = f" in {totals['plays']} plays" if totals["plays"] > 1 else ""
    stalls = "1 stall" if totals["stalls"] == 1 else f"{totals['stalls']} stalls"
    figure.suptitle(
        f"{name}\n{totals['frames']} frames{plays}, {totals['mean_layers']:.2f} layers on average, "
        f"{stalls} ({totals['stalled_s']:.2f} s)",
        fontsize=11,
        parse_math=False,  # a name is anybody's text
    )
    _draw_network(network, report["rates"])
    _draw_layers(layers, report["frames"])
    _draw_buffer(buffer, report)
    for axes in (network, layers, buffer):
        _mark_waits(axes, report)
        axes.grid(alpha=0.25)
        axes.spines[["top", "right"]].set_visible(False)
    buffer.set_xlabel("seconds since the stream was requested")
    buffer.set_xlim(left=0)
    network.legend(
        loc="lower left", bbox_to_anchor=(0, 1), fontsize=9, ncols=4, frameon=False, borderaxespad=0
    )
    return figure


def _draw_network(axes: Axes, rates: list[Json]) -> None:
    times_s = [one["time_s"] for one in rates]
    link = [one["link_bps"] for one in rates]
    if link and link[0] is not None:
        link_mbps = [bps / 1e6 for bps in link]
        axes.fill_between(times_s, link_mbps, step="mid", color=LINK_COLOUR, alpha=0.3, lw=0)
        axes.step(times_s, link_mbps, where="mid", color=LINK_COLOUR, lw=1.2, label="link")
    goodput_mbps = [one["goodput_bps"] / 1e6 for one in rates]
    axes.plot(times_s, goodput_mbps, color=GOODPUT_COLOUR, lw=1.5, label="received, over 0.5 s")
    axes.set_ylabel("Mbit/s")
    axes.set_ylim(bottom=0)


def _draw_layers(axes: Axes, frames: list[Json]) -> None:
    for shown in _by_play(frames):
        times_s = [frame["shown_s"] for frame in shown]
        axes.step(times_s, [f["layers"] for f in shown], where="post", color=LAYERS_COLOUR, lw=1.5)
    skipped = [frame for frame in frames if frame["drawn_s"] is None]
    if skipped:
        axes.plot(
            [frame["shown_s"] for frame in skipped],
            [frame["layers"] for frame in skipped],
            "x",
            color=STALL_COLOUR,
            ms=4,
            label="not drawn",
        )
        axes.legend(loc="lower right", fontsize=8)
    axes.set_ylabel("layers")
    axes.set_ylim(bottom=0)
    axes.yaxis.set_major_locator(MaxNLocator(integer=True))


def _draw_buffer(axes: Axes, report: Json) -> None:
    for play, shown in enumerate(_by_play(report["frames"])):
        arrivals = [one for one in report["arrivals"] if one["play"] == play]
        times_s, buffered_s = buffer_line(arrivals, shown, report["fps"])
        axes.step(times_s, buffered_s, where="post", color=BUFFER_COLOUR, lw=1.2)
        axes.fill_between(times_s, buffered_s, step="post", color=BUFFER_COLOUR, alpha=0.25, lw=0)
    axes.set_ylabel("buffered, s")
    axes.set_ylim(bottom=0)


def buffer_line(
    arrivals: list[Json], frames: list[Json], fps: float
) -> tuple[list[float], list[float]]:
    """When the buffer of one play changed, and what it then held: seconds of frames that could
    show, with layer 0 of all that they need, and had not."""
    ends = [
        (one["came_s"], max(x for x in (one["birth"], one["keyframe_frame"]) if x is not None) + 1)
        for one in arrivals
        if one["first_layer"] == 0
    ]
    first = frames[0]["frame"] if frames else 0
    nexts = [(frame["shown_s"], frame["frame"] + 1) for frame in frames]
    end = now = first
    times_s, buffered_s = [], []
    events = [(time_s, 0, place) for time_s, place in ends]
    events += [(time_s, 1, place) for time_s, place in nexts]
    for time_s, kind, place in sorted(events):
        end, now = (max(end, place), now) if kind == 0 else (end, place)
        times_s.append(time_s)
        buffered_s.append(max(0, end - now) / fps)
    return times_s, buffered_s


def _by_play(frames: list[Json]) -> Iterator[list[Json]]:
    """The frames of each play, in order."""
    numbers = np.array([frame["play"] for frame in frames])
    for play in range(int(numbers.max(initial=-1)) + 1):
        yield [frames[n] for n in np.flatnonzero(numbers == play)]


def _mark_waits(axes: Axes, report: Json) -> None:
    """Bands where nothing new was seen: before each play's first picture, and stalls."""
    waits = [
        (play["asked_s"], play["asked_s"] + play["startup_s"], START_COLOUR, "start-up")
        for play in report["plays"]
    ]
    waits += [
        (frame["due_s"], frame["shown_s"], STALL_COLOUR, "stall")
        for frame in report["frames"]
        if frame["shown_s"] > frame["due_s"]
    ]
    told: set[str] = set()
    for begin_s, end_s, colour, label in waits:
        axes.axvspan(
            begin_s, end_s, color=colour, alpha=0.55, lw=0, label=None if label in told else label
        )
        told.add(label)


COLOURS = ("#33307a", "#2a78b5", "#2fa58a", "#f0b84a", "#d8452e")


def write_stage_plot(path: Path, profile: StageProfile) -> None:
    """Draws the profile into a PNG; the file is whole or absent."""
    figure = matplotlib.figure.Figure(figsize=(10, 4.2), dpi=120, layout="constrained")
    axes = figure.subplots()
    frames = [one.frame for one in profile.frames]
    times = np.array([one.stages_ms for one in profile.frames]).T
    axes.stackplot(frames, times, labels=STAGES, colors=COLOURS)
    axes.axhline(1000 / profile.fps, color="black", lw=0.8, ls="--", label="frame duration")
    # The first frame brings a whole window, and may still compile something.
    top_ms = max(np.percentile(times.sum(axis=0), 98), 1000 / profile.fps)
    axes.set_ylim(0, 1.2 * top_ms)
    axes.set_xlim(frames[0], max(frames[-1], frames[0] + 1))
    axes.set_xlabel("frame")
    axes.set_ylabel("ms")
    name = profile.source
    name = name if len(name) <= MAX_TITLE_CHARS else f"...{name[-MAX_TITLE_CHARS:]}"
    axes.set_title(
        f"{name}, {profile.size}, {profile.renderer}",
        fontsize=10,
        parse_math=False,  # a name is anybody's text
    )
    axes.legend(ncols=6, loc="upper right", fontsize=8)
    axes.spines[["top", "right"]].set_visible(False)
    picture = io.BytesIO()
    matplotlib.backends.backend_agg.FigureCanvasAgg(figure)
    figure.savefig(picture, format="png")
    write_atomic(path, picture.getvalue())
