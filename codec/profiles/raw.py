"""Profile `raw`: the body of a chunk is every float32 as it was given, attribute by attribute."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from codec.errors import CorruptError
from codec.splats import Floats, Splats, sh_count

from .body import Body
from .quantise import Steps

CODE = 0

FLOAT32 = np.dtype("<f4")


def bytes_per_gaussian(sh_degree: int) -> int:
    """Bytes of a body for each Gaussian, before the entropy coder: 56 with DC colour."""
    return FLOAT32.itemsize * (11 + 3 * sh_count(sh_degree))


def pack_arrays(splats: Splats) -> bytes:
    """means, log_scales, quats, logit_opacities, sh: float32 little-endian, row after row."""
    return b"".join(array.astype(FLOAT32, copy=False).tobytes() for array in splats.arrays)


def read_arrays(body: memoryview, count: int, sh_degree: int) -> tuple[Floats, ...]:
    """Views of means, log_scales, quats, logit_opacities and sh in `body`, shaped as in Splats.

    Raises CorruptError for a body of another length.
    """
    if len(body) != count * bytes_per_gaussian(sh_degree):
        raise CorruptError(f"raw: a body of {len(body)} bytes for {count} Gaussians")
    values = np.frombuffer(body, FLOAT32)
    means, log_scales, quats, opacities, sh = np.split(values, np.cumsum([3, 3, 4, 1]) * count)
    return (
        means.reshape(count, 3),
        log_scales.reshape(count, 3),
        quats.reshape(count, 4),
        opacities,
        sh.reshape(count, sh_count(sh_degree), 3),
    )


def encode(splats: Splats, steps: Steps | None) -> Body:
    """Every bit is kept, so there are no steps to choose."""
    return Body(pack_arrays(splats), ())


def decode(body: memoryview, count: int, sh_degree: int) -> Splats:
    means, log_scales, quats, opacities, sh = (
        array.astype(np.float32) for array in read_arrays(body, count, sh_degree)
    )
    return Splats(means, log_scales, quats, opacities, sh)


def edges(body: memoryview, count: int, sh_degree: int) -> list[int]:
    return []


def layer_steps(layers: Sequence[Splats]) -> Sequence[Steps | None]:
    return [None] * len(layers)
