"""How much of a held-out picture the training cameras look at.

What no training camera sees stays black or becomes fog, and a score of such a picture says little
about the stream.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from codec.arrays import Doubles
from codec.camera import Camera
from codec.rig import rig_centre
from trainer.capture.capture import Capture
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
