"""Doubts whether a capture trains well, from how it was opened, its rig and its pictures.

One of them is coverage: what no training camera sees stays black or becomes fog, and a score of
such a picture says little about the stream.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from codec.arrays import Doubles
from codec.camera import Camera
from codec.rig import rig_centre
from trainer.capture.capture import HELD_OUT_NAME, Capture, Mask, Picture, named
from trainer.capture.points import in_view

UNSEEN_SHARE = 0.05
"""Share of a held-out picture that no training camera sees, from which on there is a warning."""

GRID = 24
"""Columns and rows of pixels that are looked at."""

NUM_DEPTHS = 8
"""Depths at which a pixel's ray is looked at."""


MAX_COVERED = 8
"""Held-out cameras whose coverage is printed."""


def unseen_shares(capture: Capture) -> dict[str, float]:
    """The `unseen_share` of each held-out camera, by name, the largest first."""
    cameras = [capture.cameras[i].camera for i in capture.held_out]
    shares = {camera.name: unseen_share(capture, camera) for camera in cameras}
    return dict(sorted(shares.items(), key=lambda row: -row[1]))


def describe_coverage(capture: Capture, shares: Mapping[str, float]) -> list[str]:
    """A line with how much of each held-out picture training cameras look at, the least first; none
    where the rig gives no depths. shares: what `unseen_shares` gives."""
    if capture.near_m is None or capture.far_m is None or not shares:
        return []
    # Rounded down: all of a picture is all of it.
    covered = [(name, int(100 * (1 - share) + 1e-6)) for name, share in shares.items()]
    named = [f"{percent}% of {name}" for name, percent in covered[:MAX_COVERED]]
    if len(covered) > MAX_COVERED:
        least = covered[MAX_COVERED][1]
        named.append(f"at least {least}% of {len(covered) - MAX_COVERED} more")
    return [f"covered     {', '.join(named)}: the part of a held-out picture that training sees"]


def coverage_doubts(shares: Mapping[str, float]) -> list[str]:
    """A line about the held-out cameras that look where no training camera does. shares:
    the result of `unseen_shares`."""
    found = [
        f"{share:.0%} of {name}'s picture" for name, share in shares.items() if share > UNSEEN_SHARE
    ]
    if not found:
        return []
    return [
        f"held out: no training camera sees {', '.join(found)} (from the middle of the rig "
        "outward); that part stays empty and makes its scores meaningless: hold out another camera"
    ]


def unseen_share(capture: Capture, camera: Camera) -> float:
    """Share of the camera's pixels in whose direction no training camera sees anything, from the
    depth of what the cameras look at on, or from the near plane where they look one way.

    An estimate from the cameras alone: what stands in the way is not known. 0 where the rig gives
    no depths.
    """
    cameras = [capture.cameras[i].camera for i in capture.training]
    if capture.near_m is None or capture.far_m is None:
        return 0.0
    centre = rig_centre(cameras)
    begin_m = capture.near_m
    if centre is not None:
        begin_m = max(begin_m, float((centre - camera.position) @ camera.forward))
    columns, rows = np.meshgrid(
        (np.arange(GRID) + 0.5) / GRID * camera.width_px,
        (np.arange(GRID) + 0.5) / GRID * camera.height_px,
    )
    seen = np.zeros(GRID * GRID, bool)
    for depth_m in np.geomspace(begin_m, max(begin_m, capture.far_m), NUM_DEPTHS):
        depths = np.full(GRID * GRID, depth_m)
        places: Doubles = camera.unproject(columns.ravel(), rows.ravel(), depths)
        for other in cameras:
            seen |= in_view(other, places)
    return float(1 - seen.mean())


FEW_CAMERAS = 6
"""With fewer training cameras most places are seen by too few."""

DISTANT_RAD = np.radians(30)
"""Angle between neighbouring cameras, seen from the middle, from which on they see different
things. In a dome of 27 it is at most 27 degrees."""

WHITE, BRIGHT = 254, 64
"""Values of 255: a channel from WHITE on is clipped, and a picture is dark when all but a hundredth
of it is below BRIGHT."""

CLIPPED_SHARE = 0.3
"""Share of the pixels that count whose channels are all clipped."""


def rig_doubts(capture: Capture) -> list[str]:
    """Those of its opening, and warnings of few or distant training cameras, a line each."""
    found = [*capture.doubts]
    cameras = [capture.cameras[i].camera for i in capture.training]
    if len(cameras) < FEW_CAMERAS:
        more = f" ({len(capture.cameras)} with an empty {HELD_OUT_NAME})"
        found.append(
            f"few cameras: {len(cameras)} to train on{more * bool(capture.held_out)}; with fewer "
            f"than {FEW_CAMERAS}, the scene between them is smeared"
        )
    centre = rig_centre(cameras)
    if centre is None or len(cameras) < 2:
        return found
    rays = np.array([camera.position for camera in cameras]) - centre
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    cosines = rays @ rays.T
    np.fill_diagonal(cosines, -1)
    apart = np.arccos(np.clip(cosines.max(axis=1), -1, 1))
    if float(apart.max()) > DISTANT_RAD:
        lonely = int(np.argmax(apart))
        found.append(
            f"distant cameras: {cameras[lonely].name} is {np.degrees(apart[lonely]):.0f} degrees "
            f"from the nearest other; above {np.degrees(DISTANT_RAD):.0f}, surfaces are smeared"
        )
    return found


def picture_doubt(picture: Picture, mask: Mask | None = None) -> str | None:
    """Why the numbers of a picture may not be what its camera saw, of those pixels that count."""
    pixels = picture.reshape(-1, 3) if mask is None else picture[mask > 0]
    if not len(pixels):
        return None
    if float((pixels.min(axis=1) >= WHITE).mean()) > CLIPPED_SHARE:
        return f"clipped: over {CLIPPED_SHARE:.0%} of their pixels are white"
    if float(np.percentile(pixels.max(axis=1), 99)) < BRIGHT:
        return f"dark: hardly a pixel is above {BRIGHT} of 255, like 10 or 12 bits stored in 16"
    return None


def picture_doubts(found: Mapping[str, str], num_cameras: int) -> list[str]:
    """A line for each doubt; found: what `picture_doubt` says, by camera."""
    return [
        f"pictures of {_named([c for c, said in found.items() if said == doubt], num_cameras)} are "
        f"{doubt}"
        for doubt in sorted(set(found.values()))
    ]


def _named(cameras: Sequence[str], num_cameras: int) -> str:
    return "all cameras" if len(cameras) == num_cameras else named(cameras)
