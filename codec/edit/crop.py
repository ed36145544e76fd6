"""Crop: only the Gaussians whose centres lie in a region stay, frame by frame."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
import tyro

from codec.arrays import Doubles, Flags
from codec.errors import InvalidError
from codec.slots.slotstate import holds
from codec.stream.manifest import Manifest, Point

from .edit import Edit, Turn
from .region import Box, Region, Sphere

Corners = tuple[float, float, float, float, float, float]


@dataclass(frozen=True, slots=True)
class CropOptions:
    """Where to crop: one of the regions."""

    box: Annotated[Corners | None, tyro.conf.arg(metavar="X Y Z X Y Z")] = None
    """Lower and upper corner of a box along the axes, metres."""
    sphere: Annotated[
        tuple[float, float, float, float] | None, tyro.conf.arg(metavar="X Y Z RADIUS")
    ] = None
    """Centre and radius of a sphere, metres."""
    outside: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Keep what lies outside the region instead."""

    def region(self) -> Region:
        """The region. Raises InvalidError."""
        if self.box is not None and self.sphere is None:
            return Box(np.array(self.box[:3]), np.array(self.box[3:]))
        if self.sphere is not None and self.box is None:
            return Sphere(np.array(self.sphere[:3]), self.sphere[3])
        raise InvalidError("give either --box or --sphere")


class Crop(Edit):
    """Keeps the Gaussians inside a region, or those outside it."""

    def __init__(self, options: CropOptions) -> None:
        """Raises InvalidError."""
        self._region, self._outside = options.region(), options.outside
        self._kept, self._first, self._first_kept = 0, 0, 0

    def manifest(self, source: Manifest) -> Manifest:
        """The result's manifest: `source` with bounds that reach no farther than the region."""
        if self._outside:
            return source
        low, high = self._region.box()
        lower = np.clip(source.bounds[0], low, high)
        upper = np.clip(source.bounds[1], low, high)
        return replace(source, bounds=(_point(lower), _point(upper)))

    def holds(self, means: Doubles) -> Flags:
        """(N,) which of the Gaussians at (N, 3) `means` stay."""
        inside = self._region.holds(means)
        return ~inside if self._outside else inside

    def keeps(self, turn: Turn) -> Flags:
        kept = self.holds(turn.means())
        held = holds(turn.slots.conditions)
        count = int(np.count_nonzero(kept & held))
        self._kept += count
        if turn.frame <= 0:
            self._first += int(np.count_nonzero(held))
            self._first_kept += count
        return kept

    def check(self) -> None:
        if not self._kept:
            raise InvalidError(
                f"no Gaussian is in that region in any frame, of {self._first} in frame 0; "
                "`swings-stream info STREAM` prints the bounds, --preview PNG draws the region"
            )

    @property
    def notes(self) -> tuple[str, ...]:
        """How many Gaussians have stayed, for the user."""
        return (f"kept         {self._first_kept} of {self._first} Gaussians in frame 0",)


def _point(values: np.ndarray) -> Point:
    x, y, z = (float(value) for value in values)
    return x, y, z
