"""Attributes quantised as SwinGS does (section 5.6.2, Table 6).

Means and log-scales are fp16, rotations four bytes, opacities one, colours stay float32: 29 bytes a
Gaussian with DC colour. Scales are taken as their logarithm: the paper says "fp16" and no more, and
a linear one loses precision below 2^-14 m. What fp16 cannot hold is refused, never clamped.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from codec.arrays import Bytes, Floats
from codec.errors import InvalidError
from codec.lattice.forms import opacity_logits
from codec.splats import Splats

MIDDLE = 128
"""The byte that stands for zero."""

FLOAT16 = np.dtype("<f2")
MAX_HALF = 65504
"""The largest fp16; from 65520 on, rounding would give infinity."""

OPACITY_LEVELS = 256

Halves = npt.NDArray[np.float16]


def _halves(values: Floats, what: str) -> Halves:
    """`values` rounded to the nearest fp16, ties to even. Raises InvalidError if one overflows."""
    with np.errstate(over="ignore", under="ignore"):
        halves = values.astype(FLOAT16)
    if not np.isfinite(halves).all():
        worst = float(values.flat[int(np.abs(values).argmax())])
        raise InvalidError(f"paper: a {what} of {worst:g} does not fit fp16 (at most {MAX_HALF})")
    return halves


def _rotation_bytes(quats: Floats) -> Bytes:
    """(N, 4) q * 128 + 128 of the unit quaternions, rounded; a component of +1 becomes 127 / 128.

    The numbers are those of a `.splat` file; rounding instead of cutting off halves their error.
    """
    doubles = quats.astype(np.float64)
    units = doubles / np.linalg.norm(doubles, axis=1, keepdims=True)
    turns: Bytes = np.clip(np.rint(units * MIDDLE) + MIDDLE, 0, 255).astype(np.uint8)
    return turns


def _quats(turns: Bytes) -> Floats:
    """(N, 4) of unit length but for the rounding; exact in float32."""
    return (turns.astype(np.float32) - np.float32(MIDDLE)) / np.float32(MIDDLE)


def _opacity_bytes(splats: Splats) -> Bytes:
    levels = np.rint(splats.opacities.astype(np.float64) * (OPACITY_LEVELS - 1))
    return levels.astype(np.uint8)


def _with_means(splats: Splats) -> Splats:
    return replace(splats, means=_halves(splats.means, "position").astype(np.float32))


def _with_rotation(splats: Splats) -> Splats:
    return replace(splats, quats=_quats(_rotation_bytes(splats.quats)))


def _with_scale(splats: Splats) -> Splats:
    return replace(splats, log_scales=_halves(splats.log_scales, "log-scale").astype(np.float32))


def _with_feat(splats: Splats) -> Splats:
    return replace(splats, sh=_halves(splats.sh, "colour").astype(np.float32))


def _with_opacity(splats: Splats) -> Splats:
    return replace(splats, logit_opacities=opacity_logits(OPACITY_LEVELS)[_opacity_bytes(splats)])


ATTRIBUTES: dict[str, Callable[[Splats], Splats]] = {
    "means": _with_means,
    "rotation": _with_rotation,
    "scale": _with_scale,
    "feat": _with_feat,
    "opacity": _with_opacity,
}
"""The columns of the paper's Table 6. It streams all but `feat`, which costs the most PSNR."""


def quantise_attribute(splats: Splats, attribute: str) -> Splats:
    """`splats` with one attribute, a key of ATTRIBUTES, as its quantisation leaves it.

    Raises InvalidError for another name, and for a value that fp16 cannot hold.
    """
    if attribute not in ATTRIBUTES:
        raise InvalidError(f"paper: attribute {attribute!r} is not one of {', '.join(ATTRIBUTES)}")
    return ATTRIBUTES[attribute](splats)
