"""What a stream costs over time, and how good it is: the picture of `swings-stream info`."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path

import matplotlib.backends.backend_agg
import matplotlib.figure
import numpy as np
from matplotlib.axes import Axes

from codec.errors import InvalidError
from codec.files import write_atomic
from codec.pose import Doubles
from codec.stream.index import SegmentRecord
from codec.stream.reader import StreamReader

LAYER_COLOURS = ("#33307a", "#2a78b5", "#2fa58a", "#e3a72f")
"""Of layers 0, 1, ...: the most important is the darkest. More layers take steps between."""
MEAN_COLOUR = "#b3411b"
MAX_TITLE_CHARS = 60
MAX_LEGEND_ROWS = 8


def bitrates_bps(records: Sequence[SegmentRecord], fps: float) -> Doubles:
    """(segments, layers): bits of each object for each second that its segment shows.

    Segment 0 carries the window of frame 0 too, so it is the most expensive one.
    """
    sizes = np.array([record.object_bytes for record in records], np.float64)
    seconds = np.array([record.num_frames for record in records]) / fps
    return np.asarray(8 * sizes / seconds[:, None])


def draw_stream(stream: Path, picture: Path) -> None:
    """Draws the bitrate of each layer and, where the index knows it, the PSNR over time, as a PNG
    at `picture` that appears at once and whole. Raises a SwingsError."""
    reader = StreamReader(stream)
    records, manifest = reader.records, reader.manifest
    if not records:
        raise InvalidError(f"{stream} has no frames yet; there is nothing to draw")
    edges_s = np.array([r.first_frame for r in records] + [reader.num_frames]) / manifest.fps
    rates_mbps = bitrates_bps(records, manifest.fps) / 1e6
    psnrs_db = np.array([record.psnr_db for record in records], np.float64)
    scored = not np.isnan(psnrs_db).all()
    figure = matplotlib.figure.Figure(
        figsize=(11, 7.5 if scored else 5), dpi=110, facecolor="white", layout="constrained"
    )
    matplotlib.backends.backend_agg.FigureCanvasAgg(figure)
    panels = figure.subplots(1 + scored, 1, sharex=True, squeeze=False)[:, 0]
    colours = _layer_colours(manifest.num_layers)
    duration_s = reader.num_frames / manifest.fps
    mean_mbps = 8e-6 * sum(sum(record.object_bytes) for record in records) / duration_s
    _draw_rates(panels[0], edges_s, rates_mbps, colours, mean_mbps)
    if scored:
        _draw_psnrs(panels[1], edges_s, psnrs_db, colours)
    panels[-1].set_xlabel("time (s)")
    for axes in panels:
        axes.set_xlim(edges_s[0], edges_s[-1])
        axes.grid(color="#e4e4e4", linewidth=0.6)
        axes.set_axisbelow(True)
        for side in ("top", "right"):
            axes.spines[side].set_visible(False)
    # A title is anybody's text: nothing in it is mathematics.
    title = " ".join((manifest.title or stream.resolve().name).split())[:MAX_TITLE_CHARS]
    figure.suptitle(
        f"{title}: {reader.num_frames} frames, {manifest.num_gs} Gaussians, "
        f"profile {manifest.profile}",
        parse_math=False,
    )
    drawn = io.BytesIO()
    figure.savefig(drawn, format="png")
    picture.parent.mkdir(parents=True, exist_ok=True)
    write_atomic(picture, drawn.getvalue())


def _layer_colours(num_layers: int) -> list[Doubles]:
    """(3,) RGB in 0..1 for each layer."""
    stops = np.array(
        [[int(text[i : i + 2], 16) / 255 for i in (1, 3, 5)] for text in LAYER_COLOURS]
    )
    at = np.linspace(0, len(stops) - 1, num_layers)
    places = np.arange(len(stops))
    return list(np.stack([np.interp(at, places, channel) for channel in stops.T], axis=1))


def _steps(values: Doubles) -> Doubles:
    """One value an edge: the last segment's twice."""
    return np.append(values, values[-1:])


def _draw_rates(
    axes: Axes, edges_s: Doubles, rates_mbps: Doubles, colours: list[Doubles], mean_mbps: float
) -> None:
    tops = np.cumsum(rates_mbps, axis=1)
    below = np.zeros(len(tops))
    for layer, colour in enumerate(colours):
        axes.fill_between(
            edges_s,
            _steps(below),
            _steps(tops[:, layer]),
            step="post",
            color=colour,
            linewidth=0,
            label=f"layer {layer}",
        )
        below = tops[:, layer]
    axes.stairs(tops[:, -1], edges_s, baseline=None, color="black", linewidth=1, label="total")
    axes.axhline(
        mean_mbps,
        color=MEAN_COLOUR,
        linestyle="--",
        linewidth=1.2,
        label=f"mean {mean_mbps:.3g} Mbit/s",
    )
    axes.set_ylim(bottom=0)
    axes.set_ylabel("bitrate (Mbit/s)")
    axes.set_title(
        "bitrate of each segment; the first also carries the window of frame 0",
        fontsize=10,
        loc="left",
    )
    _legend(axes)


def _draw_psnrs(axes: Axes, edges_s: Doubles, psnrs_db: Doubles, colours: list[Doubles]) -> None:
    for layer, colour in enumerate(colours):
        label = "layer 0" if layer == 0 else f"layers 0..{layer}"
        axes.stairs(
            psnrs_db[:, layer], edges_s, baseline=None, color=colour, linewidth=2, label=label
        )
    axes.margins(y=0.1)
    axes.set_ylabel("PSNR (dB)")
    axes.set_title("quality of each segment, as the index says", fontsize=10, loc="left")
    _legend(axes)


def _legend(axes: Axes) -> None:
    """Beside the axes, the uppermost layer first, where it hides nothing."""
    handles, labels = axes.get_legend_handles_labels()
    axes.legend(
        handles[::-1],
        labels[::-1],
        loc="upper left",
        bbox_to_anchor=(1.01, 1),
        borderaxespad=0,
        frameon=False,
        fontsize=9,
        ncols=-(-len(handles) // (2 * MAX_LEGEND_ROWS)),
    )
