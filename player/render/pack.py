"""Gaussians as the texels that the shaders read: four words of 32 bits to a texel.

Rule: whatever does not depend on the camera is computed here once for a slice, not for each frame.
"""

from __future__ import annotations

import numpy as np

from codec.arrays import Floats, Ints
from codec.kernel import kernel
from codec.slice import HIDDEN, Slice
from codec.splats import SH_C0, sh_count

from .project import rotation_of
from .recipe import ALPHA_MIN

TEXTURE_WIDTH_PX = 2048
"""Widest row of the resident texture; every GL 3.3 driver takes it."""

NEVER = np.iinfo(np.int32).max
"""Start of a Gaussian that no frame shows."""


COLOUR_COLUMNS = 2048
"""Gaussians in a row of the texture of colours that harmonics of degree 2 and 3 give."""


def texels_per_gaussian(sh_degree: int) -> int:
    """Texels of four words: mean 3, opacity, covariance 6, colour 3, harmonics 3 each from degree 1
    on; the last two words are free."""
    return -(-(15 + 3 * (sh_count(sh_degree) - 1)) // 4)


@kernel(nogil=True)
def _pack_rows(  # type: ignore[no-untyped-def]
    means, log_scales, quats, logit_opacities, sh, birth, offsets, words, starts
):
    half, one, c0 = np.float32(0.5), np.float32(1), np.float32(SH_C0)
    alpha_min = np.float32(ALPHA_MIN)
    for i in range(means.shape[0]):
        opacity = one / (one + np.exp(-logit_opacities[i]))
        # One that is nowhere opaque enough to show is left out of every frame.
        shows = opacity >= alpha_min and offsets[i] != HIDDEN
        starts[i] = birth + offsets[i] if shows else NEVER
        qw, qx, qy, qz = quats[i, 0], quats[i, 1], quats[i, 2], quats[i, 3]
        norm = one / np.sqrt(qw * qw + qx * qx + qy * qy + qz * qz)
        r00, r01, r02, r10, r11, r12, r20, r21, r22 = rotation_of(
            qw * norm, qx * norm, qy * norm, qz * norm
        )
        s0, s1, s2 = np.exp(log_scales[i, 0]), np.exp(log_scales[i, 1]), np.exp(log_scales[i, 2])
        r00, r01, r02 = r00 * s0, r01 * s1, r02 * s2
        r10, r11, r12 = r10 * s0, r11 * s1, r12 * s2
        r20, r21, r22 = r20 * s0, r21 * s1, r22 * s2
        words[i, 0], words[i, 1], words[i, 2] = means[i, 0], means[i, 1], means[i, 2]
        words[i, 3] = opacity
        words[i, 4] = r00 * r00 + r01 * r01 + r02 * r02
        words[i, 5] = r00 * r10 + r01 * r11 + r02 * r12
        words[i, 6] = r00 * r20 + r01 * r21 + r02 * r22
        words[i, 7] = r10 * r10 + r11 * r11 + r12 * r12
        words[i, 8] = r10 * r20 + r11 * r21 + r12 * r22
        words[i, 9] = r20 * r20 + r21 * r21 + r22 * r22
        for c in range(3):
            words[i, 10 + c] = half + c0 * sh[i, 0, c]
        for k in range(sh.shape[1] - 1):
            for c in range(3):
                words[i, 13 + 3 * k + c] = sh[i, 1 + k, c]


def pack_slice(slice: Slice, words: Floats, starts: Ints) -> None:
    """Fills `words` (N, 4 * texels) and `starts` (N,), first frames, with the slice's Gaussians."""
    splats = slice.splats
    _pack_rows(
        splats.means,
        splats.log_scales,
        splats.quats,
        splats.logit_opacities,
        splats.sh,
        np.int32(slice.birth),
        slice.start_offsets,
        words,
        starts,
    )
