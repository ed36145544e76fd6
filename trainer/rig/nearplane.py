"""The near plane of a capture, from what its cameras see.

Cameras of a dome sit in its wall. Gaussians of the wall would stand right before a held-out camera
and hide the scene, so the near plane is far out: `codec.rig` puts it at a share of the
cameras' distance. Where the cameras see something that is nearer than that, it is brought in: a
little for views from anywhere, and as far as it takes for the view of the camera that sees it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from codec.arrays import Floats
from codec.camera import Camera
from codec.rig import rig_centre
from trainer.capture.capture import Capture
from trainer.pictures.scale import scaled_mask, scaled_picture
from trainer.seed.gaussians import STRAY_SHARE, nearest_seen, share_nearer, stereo_places
from trainer.seed.stereo import small_camera

FALLBACK_NEAR_M = 0.2
"""Near plane where a rig gives none. From 3DGS."""

MARGIN = 0.9
"""Near plane over the depth of the nearest thing that is seen: a Gaussian goes by its middle."""

LEAST_SHARE = 0.6
"""Smallest near plane of all views, as a share of the one that the rig suggests: with a nearer one,
more can stand right before a camera that was not trained on."""

LEAST_OWN_SHARE = 0.2
"""Smallest near plane of one camera's view, as such a share: what is nearer is not looked for."""

SEARCH_SHARE = LEAST_OWN_SHARE
"""Depth at which stereo begins, as a share of the near plane that the rig suggests."""

MAX_PLACES = 1 << 20
"""Places of either kind that are looked at; of more, every second, third and so on."""


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """Points that the training cameras of an inward rig see."""

    points: Floats  # (P, 3) float32, metres, world: the capture's own
    stereo: Floats  # (Q, 3) float32, metres, world: what cameras agree on, in a few frames


def look(capture: Capture, frames: range) -> Seen | None:
    """Points that the training cameras see in the first, the middle and the last of `frames`.

    None for a rig without a centre: it declares its depths itself, or has none. Raises
    CaptureError when a picture cannot be read.
    """
    cameras = [capture.cameras[i].camera for i in capture.training]
    if capture.near_m is None or capture.far_m is None or rig_centre(cameras) is None:
        return None
    small = [small_camera(camera) for camera in cameras]
    sources = [capture.open_images(i) for i in capture.training]
    chosen = sorted({frames[0], frames[len(frames) // 2], frames[-1]})
    places = []
    try:
        for frame in chosen:
            pictures = []
            for index, source, camera in zip(capture.training, sources, small, strict=True):
                picture = scaled_picture(source.read(frame), camera)
                masks = capture.cameras[index].masks
                if masks is not None:  # black agrees with black only
                    mask = scaled_mask(masks.read(frame), camera.width_px, camera.height_px)
                    picture = picture * mask[:, :, None]
                pictures.append(picture)
            begin_m = SEARCH_SHARE * capture.near_m
            places.append(stereo_places(small, pictures, begin_m, capture.far_m))
    finally:
        for source in sources:
            source.close()
    points = np.zeros((0, 3), np.float32) if capture.points is None else capture.points.xyz
    return Seen(_thinned(points), _thinned(np.concatenate(places)))


def _thinned(places: Floats) -> Floats:
    return places[:: max(1, -(-len(places) // MAX_PLACES))]


def near_plane(capture: Capture, seen: Seen | None) -> float | None:
    """Depth in front of which nothing is drawn in views from anywhere, metres: what the rig
    suggests, or less where a training camera sees something nearer. None where the rig gives
    none."""
    if capture.near_m is None or seen is None:
        return capture.near_m
    cameras: list[Camera] = [capture.cameras[i].camera for i in capture.training]
    nearest = [nearest_seen(cameras, places) for places in (seen.points, seen.stereo)]
    cut = [depth for depth in nearest if depth is not None and depth < capture.near_m]
    return max(MARGIN * min(cut), LEAST_SHARE * capture.near_m) if cut else capture.near_m


def near_planes(capture: Capture, seen: Seen | None) -> tuple[float, ...]:
    """The near plane of each camera's own view, metres: that of views from anywhere, or less where
    this camera has something nearer in view. Empty where the rig gives none, or declares it.

    Never farther: what no camera sees is not trained, and would hang as fog before views from
    between them. What is known of a held-out camera's view are places that training cameras agree
    on, and the capture's points.
    """
    common_m = near_plane(capture, seen)
    if capture.near_m is None or common_m is None or seen is None:
        return ()
    planes = []
    for entry in capture.cameras:
        depths = [nearest_seen([entry.camera], places) for places in (seen.points, seen.stereo)]
        nearest_m = min((depth for depth in depths if depth is not None), default=np.inf)
        own_m = max(MARGIN * nearest_m, LEAST_OWN_SHARE * capture.near_m)
        planes.append(min(own_m, common_m) if nearest_m < capture.near_m else common_m)
    return tuple(planes)


MAX_CUT_CAMERAS = 3
"""Cameras with a line each about what their near plane cuts off."""


def near_doubts(capture: Capture, seen: Seen | None, planes: float | Sequence[float]) -> list[str]:
    """A line for each camera from whose view its near plane cuts more than strays. planes: one for
    each camera, or one for all."""
    cut = [] if seen is None else cut_by(capture, seen, planes)
    lines = [
        f"the near plane of {name}, {near_m:.3g} units, cuts {share:.1%} of what it sees, which is "
        "lost in its view; a smaller --near-m keeps it, but can leave fog before held-out cameras: "
        "try both"
        for name, share, near_m in cut[:MAX_CUT_CAMERAS]
    ]
    if len(cut) > MAX_CUT_CAMERAS:
        others = cut[MAX_CUT_CAMERAS:]
        lines.append(
            f"the near planes of {len(others)} more cameras cut up to {others[0][1]:.1%} of what "
            "they see; see --near-m"
        )
    return lines


def cut_by(
    capture: Capture, seen: Seen, planes: float | Sequence[float]
) -> list[tuple[str, float, float]]:
    """(name, share, plane) of the cameras from whose view the near plane cuts more than strays,
    most of all first; share: of the capture's points, or of what stereo found, in the view of the
    camera. planes: one for each camera, or one for all."""
    cameras = [c.camera for c in capture.cameras]
    each = [planes] * len(cameras) if isinstance(planes, (int, float)) else planes
    rows = [
        (
            c.name,
            max(share_nearer(c, places, near_m) for places in (seen.points, seen.stereo)),
            near_m,
        )
        for c, near_m in zip(cameras, each, strict=True)
    ]
    return sorted((row for row in rows if row[1] > STRAY_SHARE), key=lambda row: -row[1])
