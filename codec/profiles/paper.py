"""Profile `paper`: the body of a chunk is quantised as SwinGS does (section 5.6.2, Table 6).

Means and log-scales are fp16, rotations four bytes, opacities one, colours stay float32: 29 bytes a
Gaussian with DC colour. Rule: what fp16 cannot hold is refused, never clamped: a Gaussian that
moved without a word is worse than an error, and `compact` and `raw` hold it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from codec.errors import CorruptError, InvalidError
from codec.splats import Floats, Splats, sh_count

from .body import Body
from .quantise import MIDDLE, Bytes, Steps, opacity_logits
from .raw import FLOAT32

CODE = 1

FLOAT16 = np.dtype("<f2")
MAX_HALF = 65504
"""The largest fp16; from 65520 on, rounding would give infinity."""

OPACITY_LEVELS = 256

Halves = npt.NDArray[np.float16]


def bytes_per_gaussian(sh_degree: int) -> int:
    """Bytes of a body for each Gaussian, before the entropy coder: 29 with DC colour."""
    return sum(_part_sizes(sh_degree))


def _part_sizes(sh_degree: int) -> tuple[int, int, int, int, int]:
    """Bytes of each attribute of a Gaussian, in the order of the file."""
    return 3 * 2, 3 * 2, 4, 1, 12 * sh_count(sh_degree)


def _halves(values: Floats, what: str) -> Halves:
    """`values` rounded to the nearest fp16, ties to even. Raises InvalidError if one overflows."""
    with np.errstate(over="ignore", under="ignore"):
        halves = values.astype(FLOAT16)
    if not np.isfinite(halves).all():
        worst = float(values.flat[int(np.abs(values).argmax())])
        raise InvalidError(
            f"paper: a {what} of {worst:g} does not fit fp16 (at most {MAX_HALF}); "
            "use profile compact or raw"
        )
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


def encode(splats: Splats, steps: Steps | None) -> Body:
    """means, log_scales (fp16), quats, opacities (bytes), sh (float32), row after row.

    The steps are the paper's own. Raises InvalidError for a mean or log-scale that fp16 cannot
    hold.
    """
    parts = (
        _halves(splats.means, "position"),
        _halves(splats.log_scales, "log-scale"),
        _rotation_bytes(splats.quats),
        _opacity_bytes(splats),
        splats.sh.astype(FLOAT32, copy=False),
    )
    data = b"".join(part.tobytes() for part in parts)
    return Body(data, _edges(len(splats), splats.sh_degree))


def decode(body: memoryview, count: int, sh_degree: int) -> Splats:
    if len(body) != count * bytes_per_gaussian(sh_degree):
        raise CorruptError(f"paper: a body of {len(body)} bytes for {count} Gaussians")
    parts = pairwise(_edges(count, sh_degree))
    means, scales, turns, levels, sh = (body[start:end] for start, end in parts)
    with np.errstate(invalid="ignore"):  # a NaN among hostile bytes; Splats refuses it
        return Splats(
            np.frombuffer(means, FLOAT16).astype(np.float32).reshape(count, 3),
            np.frombuffer(scales, FLOAT16).astype(np.float32).reshape(count, 3),
            _quats(np.frombuffer(turns, np.uint8).reshape(count, 4)),
            opacity_logits(OPACITY_LEVELS)[np.frombuffer(levels, np.uint8)],
            np.frombuffer(sh, FLOAT32).astype(np.float32).reshape(count, sh_count(sh_degree), 3),
        )


def edges(body: memoryview, count: int, sh_degree: int) -> list[int]:
    return _edges(count, sh_degree)


def _edges(count: int, sh_degree: int) -> list[int]:
    """Offsets in a body, from 0 to its end, between its attributes."""
    found = [0]
    for size in _part_sizes(sh_degree):
        found.append(found[-1] + size * count)
    return found


def layer_steps(layers: Sequence[Splats]) -> Sequence[Steps | None]:
    return [None] * len(layers)


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
"""The columns of the paper's Table 6. A chunk applies all but `feat`, which costs the most PSNR."""


def quantise_attribute(splats: Splats, attribute: str) -> Splats:
    """`splats` with one attribute, a key of ATTRIBUTES, as its quantisation leaves it.

    Raises InvalidError for another name, and for a value that fp16 cannot hold.
    """
    if attribute not in ATTRIBUTES:
        raise InvalidError(f"paper: attribute {attribute!r} is not one of {', '.join(ATTRIBUTES)}")
    return ATTRIBUTES[attribute](splats)
