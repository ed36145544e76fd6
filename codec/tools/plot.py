"""Bytes and quality of a stream over time: the picture of `swings-stream info`."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib.backends.backend_agg
import matplotlib.figure
import numpy as np
from matplotlib.axes import Axes

from codec.arrays import Doubles
from codec.errors import InvalidError
from codec.files import write_atomic
from codec.slots.slotlayout import ENDED, NEW, PREDICTED
from codec.storage.openstorage import Place
from codec.stream.reader import StreamReader
from codec.stream.segment import SegmentRecord

from .audit import count_slots

LAYER_COLOURS = ("#33307a", "#2a78b5", "#2fa58a", "#e3a72f")
"""Colours of layers 0, 1, ..., the darkest first. More layers take steps between."""
MEAN_COLOUR = "#b3411b"
SKIP_MAPS_COLOUR = "#7d7d7d"
FIRST_COLOUR = "#d5b9cd"
JOIN_COLOUR = "#9c4f8a"
STATUS_COLOURS = {"predicted": "#4a8f3c", "new": "#d98f2b", "ended": "#a8a8a8"}
MAX_TITLE_CHARS = 60
MAX_LEGEND_ROWS = 8


def bitrates_bps(records: Sequence[SegmentRecord], fps: float) -> Doubles:
    """(segments, layers): bits of each object for each second that its segment shows.

    Segment 0 carries the window of frame 0 too, so it is the most expensive one.
    """
    sizes = np.array([record.object_bytes for record in records], np.float64)
    seconds = np.array([record.num_frames for record in records]) / fps
    return np.asarray(8 * sizes / seconds[:, None])


@dataclass(frozen=True, slots=True)
class Band:
    """One of several quantities that are drawn on top of each other."""

    label: str
    colour: str | Doubles
    values: Doubles  # (segments,)


def played_bands(reader: StreamReader) -> list[Band]:
    """The bitrates, in Mbit/s, of all that a player from frame 0 on fetches: the skip maps, layer
    after layer, and the keyframes of frame 0."""
    records, manifest = reader.records, reader.manifest
    rates_mbps = bitrates_bps(records, manifest.fps).T / 1e6
    colours = _layer_colours(manifest.num_layers)
    bands = [
        Band(f"layer {layer}", *of_layer)
        for layer, of_layer in enumerate(zip(colours, rates_mbps, strict=True))
    ]
    sides_mbps = _sides_mbps(reader)
    first = np.where(np.arange(len(records)) == 0, sides_mbps[:, 1:].sum(axis=1), 0.0)
    skip_maps = Band("skipmaps", SKIP_MAPS_COLOUR, sides_mbps[:, 0])
    return [skip_maps, *bands, Band("keyframes of frame 0", FIRST_COLOUR, first)]


def _sides_mbps(reader: StreamReader) -> Doubles:
    """(segments, 1 + layers) the bitrates of the skip maps, then of each keyframe."""
    seconds = np.array([record.num_frames for record in reader.records]) / reader.manifest.fps
    sizes = np.array([record.side_bytes for record in reader.records], np.float64)
    return np.asarray(8e-6 * sizes / seconds[:, None])


def slot_bands(reader: StreamReader) -> list[Band]:
    """How many slots a slice does not keep, as a mean of each segment."""
    counts = count_slots(reader).statuses.sum(axis=1)
    counts[0] = 0  # in the keyframes
    starts = [record.first_frame for record in reader.records]
    # What is born at frame 0 does not count.
    slices = np.array([record.num_frames - (not record.segment) for record in reader.records])
    means = np.add.reduceat(counts, starts) / np.maximum(slices, 1)[:, None]
    statuses = PREDICTED, NEW, ENDED
    named = zip(STATUS_COLOURS.items(), statuses, strict=True)
    return [Band(name, colour, means[:, status]) for (name, colour), status in named]


def draw_stream(stream: Place, picture: Path) -> None:
    """Draws the bitrate of each layer, where the index knows it the PSNR, and what becomes of the
    slots, over time, as a PNG at `picture` that appears at once and whole. Raises a
    SwingsError."""
    reader = StreamReader(stream, max_gaussians=None)
    records, manifest = reader.records, reader.manifest
    if not records:
        raise InvalidError(f"{reader.name} has no frames yet; there is nothing to draw")
    edges_s = np.array([r.first_frame for r in records] + [reader.num_frames]) / manifest.fps
    psnrs_db = np.array([record.psnr_db for record in records], np.float64)
    scored = not np.isnan(psnrs_db).all()
    num_panels = 2 + scored
    figure = matplotlib.figure.Figure(
        figsize=(11, 2.5 + 2.5 * num_panels), dpi=110, facecolor="white", layout="constrained"
    )
    matplotlib.backends.backend_agg.FigureCanvasAgg(figure)
    panels = list(figure.subplots(num_panels, 1, sharex=True, squeeze=False)[:, 0])
    duration_s = reader.num_frames / manifest.fps
    mean_mbps = 8e-6 * sum(record.played_bytes for record in records) / duration_s
    _draw_rates(panels[0], edges_s, reader, mean_mbps)
    if scored:
        _draw_psnrs(panels[1], edges_s, psnrs_db, _layer_colours(manifest.num_layers))
    _draw_slots(panels[-1], edges_s, reader)
    panels[-1].set_xlabel("time (s)")
    for axes in panels:
        axes.set_xlim(edges_s[0], edges_s[-1])
        axes.grid(color="#e4e4e4", linewidth=0.6)
        axes.set_axisbelow(True)
        for side in ("top", "right"):
            axes.spines[side].set_visible(False)
    # A title is anybody's text: nothing in it is mathematics.
    title = " ".join((manifest.title or reader.storage.last_name).split())[:MAX_TITLE_CHARS]
    figure.suptitle(
        f"{title}: {reader.num_frames} frames, {manifest.num_gs} Gaussians",
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


def _draw_bands(axes: Axes, edges_s: Doubles, bands: Sequence[Band]) -> None:
    below = np.zeros(len(edges_s) - 1)
    for band in bands:
        top = below + band.values
        axes.fill_between(
            edges_s,
            _steps(below),
            _steps(top),
            step="post",
            color=band.colour,
            linewidth=0,
            label=band.label,
        )
        below = top
    axes.stairs(below, edges_s, baseline=None, color="black", linewidth=1, label="total")
    axes.set_ylim(bottom=0)


def _draw_rates(axes: Axes, edges_s: Doubles, reader: StreamReader, mean_mbps: float) -> None:
    _draw_bands(axes, edges_s, played_bands(reader))
    if len(reader.records) > 1:
        axes.stairs(
            _sides_mbps(reader)[1:, 1:].sum(axis=1),
            edges_s[1:],
            baseline=None,
            color=JOIN_COLOUR,
            linestyle=":",
            linewidth=1.5,
            label="keyframes, for joining players",
        )
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
        "bitrate of each segment; the first also carries the keyframes of frame 0",
        fontsize=10,
        loc="left",
    )
    _legend(axes)


def _draw_slots(axes: Axes, edges_s: Doubles, reader: StreamReader) -> None:
    _draw_bands(axes, edges_s, slot_bands(reader))
    axes.set_ylabel("slots a slice")
    axes.set_title(
        f"changes of the {reader.manifest.slice_size} slots of a slice; all others are kept",
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
    axes.set_title("quality of each segment, from the index", fontsize=10, loc="left")
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
