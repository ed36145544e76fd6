"""The .splat file, in and out: 32 bytes a Gaussian, colour without view dependence.

Layout (antimatter15/splat, `convert.py`), record after record, without a header:

    0   f32 x 3   position, frame RDF as in the PLY
    12  f32 x 3   standard deviations, linear
    24  u8 x 4    red, green, blue (0.5 + SH_C0 f_dc) * 255 and opacity * 255
    28  u8 x 4    quaternion w, x, y, z as q * 128 + 128

Records come in order of falling volume times opacity, so that a viewer can show a part of the file.
There is no magic: any file of a whole number of records can be one, if its values are finite.
"""

from __future__ import annotations

import numpy as np

from codec.errors import CorruptError
from codec.splats import SH_C0, Splats

from .bounds import (
    MAX_GAUSSIANS,
    Decoded,
    byte_logits,
    check_count,
    clipped_bytes,
    opacity_bytes,
    unit_quats,
)

RECORD = np.dtype([("xyz", "<f4", 3), ("scale", "<f4", 3), ("rgba", "u1", 4), ("rot", "u1", 4)])
assert RECORD.itemsize == 32

SMALLEST_SCALE = float(np.finfo(np.float32).tiny)
LARGEST_SCALE = float(np.finfo(np.float32).max)


def splat_count(file_bytes: int, max_gaussians: int = MAX_GAUSSIANS) -> int:
    """The Gaussians of a .splat file of `file_bytes`. Raises CorruptError, or UnsupportedError for
    more than `max_gaussians`."""
    if file_bytes % RECORD.itemsize:
        raise CorruptError(
            f".splat: {file_bytes} bytes are not a whole number of records of {RECORD.itemsize}"
        )
    return check_count(".splat", file_bytes // RECORD.itemsize, max_gaussians)


def decode_splat(data: bytes, max_gaussians: int = MAX_GAUSSIANS) -> Splats:
    """The Gaussians of a .splat file, SH degree 0. Raises CorruptError, or UnsupportedError for
    more than `max_gaussians`."""
    made = Decoded.empty(splat_count(len(data), max_gaussians), 0)
    records = np.frombuffer(data, RECORD)
    for block in made.blocks():
        rows = records[block]
        with np.errstate(invalid="ignore"):  # NaN is refused, here or below
            scales = rows["scale"].astype(np.float64)
            made.means[block] = rows["xyz"]
            if not (scales >= 0).all():
                raise CorruptError(".splat: a standard deviation is negative or not a number")
        # A flat Gaussian may have a scale of exactly 0, which has no logarithm.
        made.log_scales[block] = np.log(np.maximum(scales, SMALLEST_SCALE))
        made.quats[block] = (rows["rot"].astype(np.float32) - 128) / 128
        made.logit_opacities[block] = byte_logits(rows["rgba"][:, 3])
        made.sh[block] = (rows["rgba"][:, None, :3] / 255.0 - 0.5) / SH_C0
    return made.checked(".splat")


def encode_splat(splats: Splats) -> bytes:
    """The .splat file of `splats`, most important first.

    Lost: spherical harmonics above degree 0, colours outside 0..1, precision to 8 bits of colour,
    opacity and rotation.
    """
    volume = splats.log_scales.astype(np.float64).sum(axis=1)
    with np.errstate(divide="ignore"):
        order = np.argsort(-(volume + np.log(splats.opacities)), kind="stable")
    splats = splats.take(order)
    rows = np.empty(len(splats), RECORD)
    rows["xyz"] = splats.means
    with np.errstate(over="ignore", under="ignore"):
        scales = np.exp(splats.log_scales.astype(np.float64))
    rows["scale"] = np.clip(scales, SMALLEST_SCALE, LARGEST_SCALE)
    rows["rgba"][:, :3] = clipped_bytes((0.5 + SH_C0 * splats.sh[:, 0].astype(np.float64)) * 255)
    rows["rgba"][:, 3] = opacity_bytes(splats.opacities)
    rows["rot"] = clipped_bytes(unit_quats(splats.quats) * 128 + 128)
    return rows.tobytes()
