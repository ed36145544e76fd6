"""The near plane of a capture, from what its cameras see.

Cameras of a dome sit in its wall. Gaussians of the wall would stand right before a held-out camera
and hide the scene, so the near plane is far out: `codec.rig` puts it at a share of the
cameras' distance. Where the cameras see something that is nearer than that, it is brought in.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from codec.camera import Camera
from codec.rig import rig_centre
from trainer.capture.capture import Capture
from trainer.pictures.scale import scaled_mask, scaled_picture
from trainer.seed.nearest import STRAY_SHARE, nearest_seen, share_nearer, stereo_places
from trainer.seed.stereo import small_camera

FALLBACK_NEAR_M = 0.2
"""Near plane where a rig gives none. From 3DGS."""

MARGIN = 0.9
"""Near plane over the depth of the nearest thing that is seen: a Gaussian goes by its middle."""

LEAST_SHARE = 0.6
"""Smallest near plane, as a share of the one that the rig suggests: with a nearer one, more can
stand right before a camera that was not trained on."""

SEARCH_SHARE = 0.2
"""Depth at which stereo begins, as a share of the near plane that the rig suggests."""

MAX_PLACES = 1 << 20
"""Places of either kind that are looked at; of more, every second, third and so on."""

Floats = npt.NDArray[np.float32]


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
    """Depth in front of which nothing is drawn, metres: what the rig suggests, or less where a
    training camera sees something nearer. None where the rig gives none."""
    if capture.near_m is None or seen is None:
        return capture.near_m
    cameras: list[Camera] = [capture.cameras[i].camera for i in capture.training]
    nearest = [nearest_seen(cameras, places) for places in (seen.points, seen.stereo)]
    cut = [depth for depth in nearest if depth is not None and depth < capture.near_m]
    return max(MARGIN * min(cut), LEAST_SHARE * capture.near_m) if cut else capture.near_m


MAX_CUT_CAMERAS = 3
"""Cameras of which is said what the near plane cuts off."""


def near_doubts(capture: Capture, seen: Seen | None, near_m: float) -> list[str]:
    """A line where `near_m` cuts from a camera's view more than strays; else none."""
    cut = [] if seen is None else cut_by(capture, seen, near_m)
    if not cut:
        return []
    named = [f"{share:.1%} of what {name} sees" for name, share in cut[:MAX_CUT_CAMERAS]]
    if len(cut) > MAX_CUT_CAMERAS:
        named.append(f"smaller shares of {len(cut) - MAX_CUT_CAMERAS} more cameras")
    return [
        f"the near plane, {near_m:.3g} units, cuts {', '.join(named)}, which is lost in these "
        "views; a smaller --near-m keeps it, but can leave fog before held-out cameras: try both"
    ]


def cut_by(capture: Capture, seen: Seen, near_m: float) -> list[tuple[str, float]]:
    """(name, share) of the cameras from whose view `near_m` cuts more than strays, most of all
    first; share: of the capture's points, or of what stereo found, in the view of the camera."""
    cameras = [c.camera for c in capture.cameras]
    shares = [
        (c.name, max(share_nearer(c, places, near_m) for places in (seen.points, seen.stereo)))
        for c in cameras
    ]
    return sorted((row for row in shares if row[1] > STRAY_SHARE), key=lambda row: -row[1])
