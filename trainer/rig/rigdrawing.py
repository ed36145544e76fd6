"""Cameras and points of a capture as a picture, from above and from the side, in its own axes.

Names of cameras need fonts of their own: matplotlib's has no Chinese, Japanese or Korean letters.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import matplotlib.backends.backend_agg
import matplotlib.figure
import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.collections import LineCollection
from matplotlib.font_manager import FontProperties, findfont, fontManager
from matplotlib.ft2font import FT2Font
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke
from matplotlib.ticker import FuncFormatter

from codec.arrays import Doubles
from codec.camera import Camera
from codec.files import replacing
from codec.rig import rig_centre, rig_up
from trainer.capture.capture import Capture

OWN_FAMILY = "DejaVu Sans"
"""Comes with matplotlib."""

STAND_INS = frozenset({"Last Resort High-Efficiency"})
"""Fonts whose glyphs are boxes for every letter."""


def families_for(texts: Iterable[str]) -> list[str] | None:
    """Families of installed fonts that together have all letters of `texts`, to try one after the
    other; None if no font has those that matplotlib's own lacks."""
    own = FT2Font(findfont(FontProperties(family=[OWN_FAMILY])))
    lacking = {ord(letter) for text in texts for letter in text} - own.get_charmap().keys()
    if not lacking:
        return [OWN_FAMILY]
    for entry in fontManager.ttflist:
        if entry.name in STAND_INS or entry.style != "normal":
            continue
        try:
            letters = FT2Font(entry.fname).get_charmap().keys()
        except (OSError, RuntimeError):  # has been removed, or is broken
            continue
        if lacking <= letters:
            return [OWN_FAMILY, entry.name]
    return None


TRAINING_COLOUR, HELD_OUT_COLOUR, CENTRE_COLOUR = "#1f5fbf", "#d9480f", "#2b8a3e"
FRUSTUM_SHARE = 0.07
"""Length of a drawn frustum over the extent of the cameras."""
POINT_MARGIN = 0.6
"""How far from the cameras points are drawn, in extents of the cameras: a few stray points must not
shrink the rig to a dot."""
MAX_DRAWN_POINTS = 60_000
MAX_LABELS = 64
"""With more cameras only the held-out ones are labelled."""
TILT_RAD = np.radians(20)
"""The cameras' up may be this far off the axis that is drawn upwards before the picture says so."""


def draw_capture(capture: Capture, path: Path) -> bool:
    """Draws cameras and points into a PNG that appears whole. Gives whether cameras are labelled by
    name; by their number in the capture where no installed font has the letters of the names."""
    names = [c.camera.name for c in capture.cameras]
    name = capture.root.resolve().name
    families = families_for([*names, name])
    labels = [name.removeprefix("cam") for name in names]
    if families is None:
        labels = [str(number) for number in range(len(names))]
    with rc_context({"font.family": families or [OWN_FAMILY]}):
        _draw(capture, labels, "capture" if families is None else name, path)
    return families is not None


def _draw(capture: Capture, labels: Sequence[str], name: str, path: Path) -> None:
    """labels: of the cameras. name: of the capture."""
    cameras = [c.camera for c in capture.cameras]
    axes_of_view = drawn_axes(cameras)
    positions = np.array([c.position for c in cameras]) @ axes_of_view.T
    middle = (positions.min(axis=0) + positions.max(axis=0)) / 2
    extent = max(float(np.ptp(positions, axis=0).max()), 1e-6)
    if len(cameras) == 1 and capture.far_m is not None:
        extent = capture.far_m
    points, colours = _nearby_points(capture, axes_of_view, middle, extent)
    figure = matplotlib.figure.Figure(figsize=(15, 8), dpi=110, facecolor="white")
    matplotlib.backends.backend_agg.FigureCanvasAgg(figure)
    above, side = figure.subplots(1, 2)
    centre = rig_centre(cameras)
    # Drawn axes: 0 and 1 lie in the ground, 2 points up. The eye above looks along -2, the eye at
    # the side along +1; what is nearer to it is drawn later.
    for axes, title, across, up, nearness in (
        (above, f"from above: along {axis_name(-axes_of_view[2])}", 0, 1, points[:, 2]),
        (side, f"from the side: along {axis_name(axes_of_view[1])}", 0, 2, -points[:, 1]),
    ):
        order = np.argsort(nearness, kind="stable")
        axes.scatter(
            points[order, across], points[order, up], s=3, c=colours[order], linewidths=0, zorder=1
        )
        _draw_cameras(axes, capture, labels, axes_of_view, (across, up), FRUSTUM_SHARE * extent)
        if centre is not None:
            at = axes_of_view @ centre
            axes.plot(at[across], at[up], "+", color=CENTRE_COLOUR, ms=14, mew=2, zorder=4)
        axes.set_aspect("equal", adjustable="datalim")
        axes.set_title(title)
        _label(axes.xaxis, axes_of_view[across])
        _label(axes.yaxis, axes_of_view[up])
        axes.grid(color="#e4e4e4", linewidth=0.6)
        axes.set_axisbelow(True)
        axes.margins(0.08)
        for spine in axes.spines.values():
            spine.set_color("#b0b0b0")
    handles = [
        Line2D([], [], color=TRAINING_COLOUR, label=f"to train on ({len(capture.training)})"),
        Line2D([], [], color=HELD_OUT_COLOUR, label=f"held out ({len(capture.held_out)})"),
    ]
    if centre is not None:
        handles.append(
            Line2D([], [], color=CENTRE_COLOUR, ls="", marker="+", ms=11, mew=2, label="centre")
        )
    figure.legend(handles=handles, loc="lower center", ncols=len(handles), frameon=False)
    figure.suptitle(_title(capture, name, axes_of_view), parse_math=False)
    figure.tight_layout(rect=(0, 0.04, 1, 0.99))
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as temporary:
        figure.savefig(temporary, format="png")


def drawn_axes(cameras: Sequence[Camera]) -> Doubles:
    """(3, 3) rows to draw along: across, away and up, each an axis of the capture or its opposite.

    Up is the one nearest to `rig_up`, across the first of the other two; together they are
    right-handed.
    """
    level = rig_up(cameras)
    vertical = int(np.argmax(np.abs(level)))
    up = np.zeros(3)
    up[vertical] = 1.0 if level[vertical] > 0 else -1.0
    across = np.eye(3)[1 if vertical == 0 else 0]
    return np.stack([across, np.cross(up, across), up])


def axis_name(direction: Doubles) -> str:
    """The name of an axis of the capture or of its opposite: x, -x, y and so on."""
    axis = int(np.argmax(np.abs(direction)))
    return ("" if direction[axis] > 0 else "-") + "xyz"[axis]


def _label(axis: Axis, direction: Doubles) -> None:
    """Names the axis and puts the capture's own numbers on it: its unit is not known."""
    name = axis_name(direction)
    axis.set_label_text(f"{name.removeprefix('-')} (units)")
    if name.startswith("-"):
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{0 - value:g}"))


def _title(capture: Capture, name: str, axes_of_view: Doubles) -> str:
    cameras = [c.camera for c in capture.cameras]
    rate = "" if capture.fps is None else f" at {capture.fps:g} per second"
    points = f"{len(capture.points)} points" if capture.points is not None else "no points"
    title = f"{name}: {len(cameras)} cameras, {capture.num_frames} frames{rate}, {points}"
    tilt_rad = float(np.arccos(np.clip(rig_up(cameras) @ axes_of_view[2], -1, 1)))
    if tilt_rad > TILT_RAD:
        title += (
            f"\nup, as the cameras are held, is {np.degrees(tilt_rad):.0f} degrees off "
            f"{axis_name(axes_of_view[2])}"
        )
    return title


def _nearby_points(
    capture: Capture, axes_of_view: Doubles, middle: Doubles, extent: float
) -> tuple[Doubles, Doubles]:
    """(P, 3) points to draw, level, and their (P, 3) colours 0..1."""
    if capture.points is None:
        return np.zeros((0, 3)), np.zeros((0, 3))
    xyz = capture.points.xyz.astype(np.float64) @ axes_of_view.T
    near = np.flatnonzero((np.abs(xyz - middle) <= (0.5 + POINT_MARGIN) * extent).all(axis=1))
    near = near[:: max(1, -(-len(near) // MAX_DRAWN_POINTS))]
    return xyz[near], capture.points.rgb[near] / 255


def _draw_cameras(
    axes: Axes,
    capture: Capture,
    labels: Sequence[str],
    axes_of_view: Doubles,
    shown: tuple[int, int],
    length_m: float,
) -> None:
    """Draws frusta: a pyramid from each camera's centre to its picture `length_m` ahead."""
    for entry, label in zip(capture.cameras, labels, strict=True):
        camera = entry.camera
        corners = np.array([(0, 0), (1, 0), (1, 1), (0, 1)]) * (camera.width_px, camera.height_px)
        ends = camera.unproject(corners[:, 0], corners[:, 1], np.full(4, length_m))
        flat = (np.vstack([ends, camera.position]) @ axes_of_view.T)[:, list(shown)]
        edges = [(i, (i + 1) % 4) for i in range(4)] + [(i, 4) for i in range(4)]
        colour = HELD_OUT_COLOUR if entry.held_out else TRAINING_COLOUR
        axes.add_collection(
            LineCollection(
                [flat[list(edge)] for edge in edges],
                colors=colour,
                linewidths=1.6 if entry.held_out else 0.9,
                zorder=3 if entry.held_out else 2,
            ),
            autolim=True,
        )
        axes.plot(*flat[4], "o", color=colour, ms=4.5 if entry.held_out else 3, zorder=3)
        if entry.held_out or len(capture.cameras) <= MAX_LABELS:
            # Behind the camera, where no frustum is drawn.
            back = flat[4] - flat[:4].mean(axis=0)
            back = back / max(float(np.linalg.norm(back)), 1e-9)
            axes.annotate(
                label,
                flat[4],
                xytext=tuple(back * 9),
                textcoords="offset points",
                ha="center",
                va="center",
                fontsize=7.5,
                color=colour,
                fontweight="bold" if entry.held_out else "normal",
                zorder=5,
                parse_math=False,
                path_effects=[withStroke(linewidth=2.5, foreground="white")],
            )
