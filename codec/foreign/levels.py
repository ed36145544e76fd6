"""Values that several formats keep in one byte or one word."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from codec.arrays import Bytes, Doubles, Floats


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
