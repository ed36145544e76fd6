"""What a capture holds, in lines and in a picture, to look at before hours of training."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import matplotlib.backends.backend_agg
import matplotlib.figure
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke

from codec.camera import Camera
from codec.files import replacing
from codec.pose import Doubles
from codec.rig import mean_up
from codec.storage.openstorage import Target
from trainer.capture.capture import Capture, check_trainable
from trainer.capture.depths import rig_centre
from trainer.capture.layout import open_capture
from trainer.capture.points import read_points_file

LAYOUT_NAMES = {
    "dynamic3dgs": "Dynamic 3D Gaussians",
    "dynerf": "DyNeRF",
    "colmap": "COLMAP",
    "nerfstudio": "Nerfstudio",
}
TRAINING_COLOUR, HELD_OUT_COLOUR, CENTRE_COLOUR = "#1f5fbf", "#d9480f", "#2b8a3e"
FRUSTUM_SHARE = 0.07
"""Length of a drawn frustum over the extent of the cameras."""
POINT_MARGIN = 0.6
"""How far from the cameras points are drawn, in extents of the cameras: a few stray points must not
shrink the rig to a dot."""
MAX_DRAWN_POINTS = 60_000
MAX_LABELS = 64
"""With more cameras only the held-out ones are labelled."""


def check_capture(
    target: Target, picture: Path | None = None, points: Path | None = None
) -> list[str]:
    """Opens a capture, reads the first and the last frame of each camera with its mask, and
    describes it.

    picture: where to draw it as a PNG, if anywhere. points: a file of points in place of the
    capture's own. Raises CaptureError for what would stop training.
    """
    capture = open_capture(target)
    if points is not None:
        capture = replace(capture, points=read_points_file(points))
    for index in range(len(capture.cameras)):
        source = capture.open_images(index)
        try:
            for frame in sorted({0, capture.num_frames - 1}):
                source.read(frame)
                masks = capture.cameras[index].masks
                if masks is not None:
                    masks.read(frame)
        finally:
            source.close()
    check_trainable(capture)
    lines = describe_capture(capture)
    if picture is not None:
        draw_capture(capture, picture)
        lines.append(f"picture     {picture}")
    return lines


def describe_capture(capture: Capture) -> list[str]:
    """Lines for people: layout, cameras, held-out cameras, sizes, masks, frames, depths, points."""
    cameras = [c.camera for c in capture.cameras]
    sizes = Counter(f"{c.width_px}x{c.height_px}" for c in cameras)
    seconds = capture.num_frames / capture.fps
    centre = rig_centre(cameras)
    depths = (
        "the rig does not tell"
        if capture.near_m is None or capture.far_m is None
        else f"{capture.near_m:.3g} to {capture.far_m:.3g} m"
    )
    if len(sizes) == 1:
        size = f"{next(iter(sizes))} px"
    else:
        size = ", ".join(f"{size} px ({count})" for size, count in sizes.most_common())
    held_out = [cameras[i].name for i in capture.held_out]
    return [
        f"capture     {capture.root}",
        f"layout      {LAYOUT_NAMES[capture.layout]}",
        f"cameras     {len(cameras)}, of which {len(capture.training)} to train on",
        f"held out    {', '.join(held_out) or 'none: nothing to score with'}",
        f"size        {size}",
        f"masks       {_describe_masks(capture)}",
        f"frames      {capture.num_frames} at {capture.fps:g} per second: {seconds:.1f} s",
        "rig         "
        + (
            "looks one way"
            if centre is None
            else f"looks at ({', '.join(f'{x:.2f}' for x in centre)}) m"
        ),
        f"depth       {depths}",
        f"points      {len(capture.points) if capture.points is not None else 'none'}",
    ]


def _describe_masks(capture: Capture) -> str:
    masks = [c.masks for c in capture.cameras if c.masks is not None]
    if not masks:
        return "none: every pixel counts"
    still = sum(m.is_still for m in masks)
    return (
        f"{len(masks)} of {len(capture.cameras)} cameras have them, {still} one for all frames; "
        "black is ignored"
    )


def draw_capture(capture: Capture, path: Path) -> None:
    """Draws cameras and points, from above and from the side, into a PNG that appears whole."""
    cameras = [c.camera for c in capture.cameras]
    axes_of_view = level_axes(cameras)
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
    # Level axes: 0 and 1 lie in the ground, 2 points up. The eye above looks along -2, the eye at
    # the side along +1; what is nearer to it is drawn later.
    for axes, title, across, up, nearness in (
        (above, "from above", 0, 1, points[:, 2]),
        (side, "from the side", 0, 2, -points[:, 1]),
    ):
        order = np.argsort(nearness, kind="stable")
        axes.scatter(
            points[order, across], points[order, up], s=3, c=colours[order], linewidths=0, zorder=1
        )
        _draw_cameras(axes, capture, axes_of_view, (across, up), FRUSTUM_SHARE * extent)
        if centre is not None:
            at = axes_of_view @ centre
            axes.plot(at[across], at[up], "+", color=CENTRE_COLOUR, ms=14, mew=2, zorder=4)
        axes.set_aspect("equal", adjustable="datalim")
        axes.set_title(title)
        axes.set_xlabel("m")
        axes.set_ylabel("m")
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
    figure.suptitle(
        f"{capture.root.resolve().name}: {len(cameras)} cameras, {capture.num_frames} frames at "
        f"{capture.fps:g} per second, "
        + (f"{len(capture.points)} points" if capture.points is not None else "no points")
    )
    figure.tight_layout(rect=(0, 0.04, 1, 0.99))
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as temporary:
        figure.savefig(temporary, format="png")


def level_axes(cameras: Sequence[Camera]) -> Doubles:
    """(3, 3) orthonormal rows to draw along: across and away in the ground, and up.

    Up is that of `mean_up`; across is the ground direction in which the cameras are spread most,
    to the right of most pictures.
    """
    up = mean_up(cameras)
    level = np.eye(3) - np.outer(up, up)
    positions = np.array([c.position for c in cameras])
    spread = (positions - positions.mean(axis=0)) @ level
    if np.linalg.norm(spread) < 1e-9:
        spread = cameras[0].right[None] @ level
    if np.linalg.norm(spread) < 1e-9:
        spread = level
    across = np.linalg.svd(spread, full_matrices=False)[2][0] @ level
    across = across / np.linalg.norm(across)
    if float(sum(c.right @ across for c in cameras)) < 0:
        across = -across
    return np.stack([across, np.cross(up, across), up])


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
    axes: Axes, capture: Capture, axes_of_view: Doubles, shown: tuple[int, int], length_m: float
) -> None:
    """Draws frusta: a pyramid from each camera's centre to its picture `length_m` ahead."""
    for entry in capture.cameras:
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
                camera.name.removeprefix("cam"),
                flat[4],
                xytext=tuple(back * 9),
                textcoords="offset points",
                ha="center",
                va="center",
                fontsize=7.5,
                color=colour,
                fontweight="bold" if entry.held_out else "normal",
                zorder=5,
                path_effects=[withStroke(linewidth=2.5, foreground="white")],
            )
