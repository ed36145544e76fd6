"""Gaussians as bytes with every float32 as it was given, attribute by attribute."""

from __future__ import annotations

import numpy as np

from codec.arrays import Floats
from codec.errors import CorruptError
from codec.splats import Splats, sh_count

FLOAT32 = np.dtype("<f4")


def bytes_per_gaussian(sh_degree: int) -> int:
    """Bytes of a Gaussian, before the entropy coder: 56 with DC colour."""
    return FLOAT32.itemsize * (11 + 3 * sh_count(sh_degree))


def pack_arrays(splats: Splats) -> bytes:
    """means, log_scales, quats, logit_opacities, sh: float32 little-endian, row after row."""
    return b"".join(array.astype(FLOAT32, copy=False).tobytes() for array in splats.arrays)


def read_arrays(body: memoryview, count: int, sh_degree: int) -> tuple[Floats, ...]:
    """Views of means, log_scales, quats, logit_opacities and sh in `body`, shaped as in Splats.

    Raises CorruptError for another length.
    """
    if len(body) != count * bytes_per_gaussian(sh_degree):
        raise CorruptError(f"floats: {len(body)} bytes for {count} Gaussians")
    values = np.frombuffer(body, FLOAT32)
    means, log_scales, quats, opacities, sh = np.split(values, np.cumsum([3, 3, 4, 1]) * count)
    return (
        means.reshape(count, 3),
        log_scales.reshape(count, 3),
        quats.reshape(count, 4),
        opacities,
        sh.reshape(count, sh_count(sh_degree), 3),
    )
