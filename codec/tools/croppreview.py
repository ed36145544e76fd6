"""What a crop keeps and what it removes, as a picture with axes in metres."""

from __future__ import annotations

import io
from pathlib import Path

import matplotlib.backends.backend_agg
import matplotlib.figure
import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle, Rectangle

from codec.arrays import Doubles
from codec.edit.filters import Crop, CropOptions
from codec.edit.rewrite import open_source
from codec.edit.transform import Box, Region
from codec.errors import InvalidError
from codec.files import write_atomic
from codec.splats import SH_C0
from codec.storage.openstorage import Place

VIEWS = (("from the front", 0, 1), ("from the right", 2, 1), ("from above", 0, 2))
"""Pictures, and which axes of the world point right and, but for the last one, down in them."""
MOST_POINTS = 40_000
MARGIN_SHARE = 0.25
"""Room around the bounds of the stream and the region, as a share of their size: what lies farther
away is not drawn."""
GONE_COLOUR, REGION_COLOUR = "#d9480f", "#111111"


def draw_crop(
    stream: Place, options: CropOptions, picture: Path, max_gaussians: int | None
) -> tuple[int, int]:
    """Draws the Gaussians of frame 0 from three sides as a PNG at `picture`, which appears whole or
    not at all; gives how many stay, and of how many. Raises a SwingsError."""
    reader = open_source(stream, max_gaussians)
    region = options.region()
    splats = reader.active_splats(0, reader.manifest.num_layers)
    means = splats.means.astype(np.float64)
    kept = Crop(options).holds(means)
    low, high = _room(np.array(reader.manifest.bounds), region)
    shown = np.flatnonzero(((low <= means) & (means <= high)).all(axis=1))
    if len(shown) > MOST_POINTS:
        shown = np.sort(np.random.default_rng(0).choice(shown, MOST_POINTS, replace=False))
    rgba = np.c_[np.clip(0.5 + SH_C0 * splats.sh[:, 0], 0, 1), 0.2 + 0.8 * splats.opacities]
    figure = matplotlib.figure.Figure(
        figsize=(15, 5.6), dpi=100, facecolor="white", layout="constrained"
    )
    matplotlib.backends.backend_agg.FigureCanvasAgg(figure)
    for axes, (title, right, down) in zip(figure.subplots(1, 3), VIEWS, strict=True):
        stays, goes = shown[kept[shown]], shown[~kept[shown]]
        axes.scatter(*means[goes][:, [right, down]].T, s=3, color=GONE_COLOUR, alpha=0.35, lw=0)
        axes.scatter(*means[stays][:, [right, down]].T, s=6, c=rgba[stays], lw=0)
        _outline(axes, region, right, down)
        axes.set(
            title=title,
            xlabel=f"{'xyz'[right]} (m)",
            ylabel=f"{'xyz'[down]} (m)",
            xlim=(low[right], high[right]),
            ylim=(high[down], low[down]) if down == 1 else (low[down], high[down]),
            aspect="equal",
            facecolor="#e9e9e9",
        )
        axes.grid(color="white", linewidth=0.8)
        axes.set_axisbelow(True)
    count, total = int(kept.sum()), len(kept)
    figure.suptitle(
        f"frame 0: {count} of {total} Gaussians stay, in their colours; the red ones go; "
        f"{total - int(((low <= means) & (means <= high)).all(axis=1).sum())} lie farther away"
    )
    drawn = io.BytesIO()
    figure.savefig(drawn, format="png")
    try:
        picture.parent.mkdir(parents=True, exist_ok=True)
        write_atomic(picture, drawn.getvalue())
    except OSError as error:
        raise InvalidError(f"{picture} cannot be written: {error.strerror}") from error
    return count, total


def _room(bounds: Doubles, region: Region) -> tuple[Doubles, Doubles]:
    """(3,) lower and upper corner of what is drawn, metres."""
    lower, upper = region.box()
    low, high = np.minimum(bounds[0], lower), np.maximum(bounds[1], upper)
    margin = MARGIN_SHARE * (high - low).max()
    return low - margin, high + margin


def _outline(axes: Axes, region: Region, right: int, down: int) -> None:
    lower, upper = region.box()
    x, y = (float(lower[axis]) for axis in (right, down))
    width, height = (float(upper[axis] - lower[axis]) for axis in (right, down))
    shape: Rectangle | Circle = Rectangle((x, y), width, height)
    if not isinstance(region, Box):
        shape = Circle((x + width / 2, y + height / 2), width / 2)
    shape.set(fill=False, edgecolor=REGION_COLOUR, linewidth=1.5)
    axes.add_patch(shape)
