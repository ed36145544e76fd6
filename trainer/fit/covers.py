"""Covers: how Gaussians of upper layers begin, inside one of a lower layer and smaller than it.

A Gaussian that is relocated halves the opacity of its target, which a lower layer needs where it is
shown alone. A cover leaves the Gaussian below as it is and has the detail that is missing there to
learn. All constants were measured on PanopticSports basketball at half size: bench/NOTEBOOK.md.
"""

from __future__ import annotations

import numpy as np

from codec.camera import rotation_of
from codec.foreign.bounds import unit_quats
from codec.splats import Splats

COVER_OFFSET = 0.7
"""Standard deviation of a cover's distance from the middle of the Gaussian below, in that one's own
standard deviations. The covers of a Gaussian together are about as large as it: 0.7^2 + 0.6^2."""

COVER_SCALE = 0.6
"""Scales of a cover over those of the Gaussian below."""

COVER_OPACITY = 0.4
"""Opacity of a cover. With 0.22 and with 0.7 the ladder is worse."""


def covers_of(below: Splats, rng: np.random.Generator) -> Splats:
    """A cover of each of the Gaussians `below`, with its rotation and colour."""
    log_scales = below.log_scales + np.float32(np.log(COVER_SCALE))
    offsets = COVER_OFFSET * rng.normal(size=below.means.shape) * np.exp(below.log_scales)
    rotations = rotation_of(unit_quats(below.quats).T)  # (3, 3, N)
    means = below.means + np.einsum("ijn,nj->ni", rotations, offsets).astype(np.float32)
    logit = np.float32(np.log(COVER_OPACITY / (1 - COVER_OPACITY)))
    logits = np.full(len(below), logit, np.float32)
    return Splats(means, log_scales, below.quats, logits, below.sh)
