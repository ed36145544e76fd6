"""Doubts whether a capture trains well, from how it was opened, its rig and its pictures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from codec.rig import rig_centre
from trainer.capture.camerachoice import named
from trainer.capture.capture import Capture, Mask, Picture
from trainer.capture.held_out import HELD_OUT_NAME

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
