"""Checks of every reader of foreign files, made before anything is allocated, and the values that
several formats keep in one byte or one word.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from codec.arrays import Bytes, Doubles, Floats
from codec.errors import CorruptError, InvalidError, UnsupportedError
from codec.splats import Splats, array_shapes

from .notes import notes

MAX_GAUSSIANS = 1 << 24
"""Gaussians in a file: about 4 GB as float32 with SH degree 3."""

MAX_RATIO = 1000
"""Decompressed bytes for each byte of a file; real models stay below 20."""

RATIO_SLACK_BYTES = 1 << 20
"""Decompressed bytes that any file may have, so that tiny uniform models pass."""

FREE_FRAMES = 10_000
"""Frames that any file may have; of more each takes a byte of the file at least."""

BLOCK_GAUSSIANS = 1 << 16
"""Gaussians decoded at a time, a multiple of 256: wider numbers on the way to float32 cost memory
for these alone."""


def check_count(what: str, count: int, limit: int = MAX_GAUSSIANS) -> int:
    """`count`, the Gaussians that a header claims.

    Raises CorruptError over MAX_GAUSSIANS, UnsupportedError over `limit`, what the caller can take.
    """
    if count > MAX_GAUSSIANS:
        raise CorruptError(f"{what}: claims {count} Gaussians, at most {MAX_GAUSSIANS}")
    if count > limit:
        raise UnsupportedError(f"{what}: {count} Gaussians in a frame, at most {limit}")
    return count


def check_ratio(what: str, raw_bytes: int, file_bytes: int) -> None:
    """Raises CorruptError if `raw_bytes` are more than a file of `file_bytes` can decompress to."""
    if raw_bytes > MAX_RATIO * file_bytes + RATIO_SLACK_BYTES:
        raise CorruptError(
            f"{what}: a file of {file_bytes} bytes claims to decompress to {raw_bytes}"
        )


def check_frames(what: str, count: int, file_bytes: int) -> None:
    """Raises CorruptError if `count` frames are more than a file of `file_bytes` can have."""
    if count > max(FREE_FRAMES, file_bytes):
        raise CorruptError(f"{what}: a file of {file_bytes} bytes claims {count} frames")


@dataclass(frozen=True, slots=True)
class Decoded:
    """The arrays of a Splats, allocated to be filled block by block."""

    means: Floats
    log_scales: Floats
    quats: Floats
    logit_opacities: Floats
    sh: Floats

    @staticmethod
    def empty(count: int, sh_degree: int) -> Decoded:
        return Decoded(*(np.empty(s, np.float32) for s in array_shapes(count, sh_degree)))

    @property
    def opacities(self) -> Doubles:
        """(N,) float64 in (0, 1)."""
        opacities: Doubles = 0.5 + 0.5 * np.tanh(0.5 * self.logit_opacities.astype(np.float64))
        return opacities

    def blocks(self) -> list[slice]:
        """Rows of BLOCK_GAUSSIANS and fewer that together are all."""
        count = len(self.means)
        return [
            slice(first, min(first + BLOCK_GAUSSIANS, count))
            for first in range(0, count, BLOCK_GAUSSIANS)
        ]

    def checked(self, what: str) -> Splats:
        """The Gaussians that are whole; see `whole_rows`."""
        return whole_rows(
            what, self.means, self.log_scales, self.quats, self.logit_opacities, self.sh
        )


def whole_rows(
    what: str, means: Floats, log_scales: Floats, quats: Floats, logits: Floats, sh: Floats
) -> Splats:
    """The Gaussians without those that have a value that is not finite, as trainers write a few.
    The notes count them.

    Raises a CorruptError that names the first Gaussian at fault if half of them or more are, or if
    one has a rotation of length 0, as in a file of which only the room has been made.
    """
    arrays = (means, log_scales, quats, logits, sh)
    try:
        return Splats(*arrays)
    except InvalidError as error:
        good = np.isfinite(logits)
        for values in (means, log_scales, quats, sh):
            good &= np.isfinite(values).reshape(len(good), -1).all(axis=1)
        finite = int(good.sum())
        good[good] = quats[good].any(axis=1)
        bad = np.flatnonzero(~good)
        which = f"{len(bad)} of {len(good)} Gaussians, the first is number {bad[0]}"
        if good.sum() < finite or 2 * len(bad) >= len(good):
            raise CorruptError(f"{what}: {error} ({which})") from error
        notes().leave_out(len(bad), f"left out: {which}; {error}")
        return Splats(*(array[good] for array in arrays))


def opacity_bytes(opacities: Floats) -> Bytes:
    """(N,) levels 0..255 of opacities 0..1."""
    return clipped_bytes(opacities.astype(np.float64) * 255)


def byte_logits(levels: Bytes) -> Floats:
    """(N,) logits of opacity levels.

    0 and 255 have no finite logit: they are taken a quarter of a level inwards, which still rounds
    to the same level.
    """
    opacities = np.clip(levels.astype(np.float64), 0.25, 254.75) / 255
    logits: Floats = np.log(opacities / (1 - opacities)).astype(np.float32)
    return logits


def clipped_bytes(values: npt.NDArray[np.floating]) -> Bytes:
    """`values` rounded and clipped to 0..255."""
    levels: Bytes = np.clip(np.rint(values), 0, 255).astype(np.uint8)
    return levels


def unit_quats(quats: Floats) -> Doubles:
    """(N, 4) `quats` with norm 1."""
    wide = quats.astype(np.float64)
    # Divide by the largest component first: squares of float32 could leave float64's good range.
    wide /= np.abs(wide).max(axis=1, keepdims=True, initial=0.0)
    unit: Doubles = wide / np.linalg.norm(wide, axis=1, keepdims=True)
    return unit


def restore_largest(smaller: Doubles, largest: npt.NDArray[np.integer]) -> Doubles:
    """(N, 4) unit vectors of which `smaller` holds, in order, all components but `largest`."""
    squares = np.einsum("ij,ij->i", smaller, smaller)
    rows = np.arange(len(smaller))[:, None]
    full = np.empty((len(smaller), 4))
    # Column j of the stored three goes to j, or one further from the missing component on.
    places = np.arange(3) + (np.arange(3) >= largest[:, None])
    full[rows, places] = smaller
    full[rows[:, 0], largest] = np.sqrt(np.maximum(0.0, 1.0 - squares))
    return full


def split_largest(unit: Doubles) -> tuple[npt.NDArray[np.intp], Doubles]:
    """(N,) which component of each of the (N, 4) unit vectors is largest, and (N, 3) the others in
    order, of the vector or its negative: the one left out is positive.

    A quaternion and its negative are the same rotation.
    """
    rows = np.arange(len(unit))
    largest = np.abs(unit).argmax(axis=1)
    signed = unit * np.where(unit[rows, largest] < 0, -1.0, 1.0)[:, None]
    return largest, np.delete(signed.ravel(), rows * 4 + largest).reshape(-1, 3)
