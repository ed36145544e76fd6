"""What a foreign file may claim: bounds that hold before anything is allocated."""

from __future__ import annotations

import numpy as np

from ..errors import CorruptError, InvalidError
from ..splats import Floats, Splats

MAX_GAUSSIANS = 1 << 24
"""Gaussians in a file: 248 bytes each as float32 with SH degree 3, about 4 GB."""

MAX_RATIO = 1000
"""Decompressed bytes for each byte of a file; real models stay below 20."""

RATIO_SLACK_BYTES = 1 << 20
"""Decompressed bytes that need no justification, so that tiny uniform models pass."""


def check_count(what: str, count: int) -> int:
    """`count`, the Gaussians that a header claims. Raises CorruptError over MAX_GAUSSIANS."""
    if count > MAX_GAUSSIANS:
        raise CorruptError(f"{what}: claims {count} Gaussians, at most {MAX_GAUSSIANS}")
    return count


def check_ratio(what: str, raw_bytes: int, file_bytes: int) -> None:
    """Raises CorruptError when `file_bytes` cannot honestly hold `raw_bytes`."""
    if raw_bytes > MAX_RATIO * file_bytes + RATIO_SLACK_BYTES:
        raise CorruptError(f"{what}: {file_bytes} bytes claim to hold {raw_bytes}; a bomb")


def checked_splats(
    what: str, means: Floats, log_scales: Floats, quats: Floats, logit_opacities: Floats, sh: Floats
) -> Splats:
    """A Splats of decoded values. Raises CorruptError that names the first Gaussian at fault."""
    try:
        return Splats(means, log_scales, quats, logit_opacities, sh)
    except InvalidError as error:
        good = np.isfinite(logit_opacities)
        for values in (means, log_scales, quats, sh):
            good &= np.isfinite(values).reshape(len(good), -1).all(axis=1)
        good[good] = quats[good].any(axis=1)
        bad = np.flatnonzero(~good)
        raise CorruptError(
            f"{what}: {error} ({len(bad)} of {len(good)} Gaussians, the first is number {bad[0]})"
        ) from error
