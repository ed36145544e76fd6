"""Edits that remove Gaussians: `Crop` those outside a region, frame by frame; `Floaters` those that
few cameras ever see at a time, over their whole life.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
import tyro

from codec.arrays import Doubles, Flags, Longs
from codec.camera import Camera
from codec.errors import InvalidError
from codec.slots.slotlayout import KEPT, NEW
from codec.slots.state import holds
from codec.stream.manifest import Manifest, Point

from .transform import Box, Region, Sphere
from .walk import Edit, Turn, Walk

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


@dataclass(frozen=True, slots=True)
class FloaterOptions:
    """Which Gaussians are floaters."""

    cameras: int = 2
    """A Gaussian stays if at least so many of the stream's cameras see its centre at the same time,
    at any time of its life."""
    margin: float = 0.0
    """Share of a picture's width and height by which a centre may lie outside it and still count as
    seen."""

    def __post_init__(self) -> None:
        if self.cameras < 1:
            raise InvalidError(f"cameras {self.cameras}: choose at least 1")
        if not 0 <= self.margin <= 10:
            raise InvalidError(f"margin {self.margin:g}: choose 0 to 10")


class Lives:
    """Numbers the Gaussians of a stream in the order in which they come: one that is predicted or
    kept has its number still."""

    def __init__(self) -> None:
        self.count = 0
        self._numbers: dict[tuple[int, int], Longs] = {}

    def of(self, turn: Turn) -> Longs:
        """(S,) the numbers of what the slots hold after `turn`, the next one; those of empty slots
        mean nothing."""
        key = turn.lane, turn.layer
        numbers = self._numbers.setdefault(key, np.zeros(len(turn.slots), np.int64))
        new = np.flatnonzero(turn.statuses == NEW)
        numbers[new] = self.count + np.arange(len(new))
        self.count += len(new)
        return numbers


class Floaters(Edit):
    """Removes each Gaussian that is not in view at any time. Takes a byte of memory for each
    Gaussian that is sent."""

    def __init__(self, options: FloaterOptions, source: Manifest) -> None:
        """Raises InvalidError if the stream has too few cameras."""
        if len(source.cameras) < options.cameras:
            raise InvalidError(
                f"cameras {options.cameras}: the stream has only {len(source.cameras)}; "
                "give --cameras as many or fewer"
            )
        self._options, self._source = options, source
        self._seen = np.zeros(1 << 16, np.bool_)
        self._lives = Lives()

    @property
    def notes(self) -> tuple[str, ...]:
        """How many floaters there are, once the stream is edited."""
        count = self._lives.count
        found = int(np.count_nonzero(~self._seen[:count]))
        return (f"floaters     {found} of {count} Gaussians",)

    def survey(self, walk: Walk) -> Iterator[int]:
        """Looks at the whole stream, which comes before any use as an edit; gives each frame."""
        lives, layout = Lives(), walk.reader.manifest.slot_layout
        num_frames = walk.reader.num_frames
        for slices in (walk.opening(0), walk.slices(range(1, num_frames))):
            for source in slices:
                for turn in source.turns(layout):
                    self._look(turn, lives.of(turn), lives.count)
                if source.birth >= 0:
                    yield source.birth

    def _look(self, turn: Turn, numbers: Longs, count: int) -> None:
        """Notes which Gaussians of a turn that have come or moved are in view."""
        while len(self._seen) < count:
            self._seen = np.concatenate([self._seen, np.zeros_like(self._seen)])
        rows = np.flatnonzero(holds(turn.slots.conditions) & (turn.statuses != KEPT))
        rows = rows[~self._seen[numbers[rows]]]
        means = turn.means()[rows]
        times_seen = np.zeros(len(rows), np.int64)
        for camera in self._source.cameras:
            times_seen += self._sees(camera, means)
        self._seen[numbers[rows[times_seen >= self._options.cameras]]] = True

    def _sees(self, camera: Camera, means: Doubles) -> Flags:
        x, y, depth = (means @ camera.w2c[:3, :3].T + camera.w2c[:3, 3]).T
        ahead: Flags = depth > self._source.near_of(camera)
        safe = np.where(ahead, depth, 1.0)
        across = (camera.fx_px * x / safe + camera.cx_px) / camera.width_px
        down = (camera.fy_px * y / safe + camera.cy_px) / camera.height_px
        low, high = -self._options.margin, 1 + self._options.margin
        inside: Flags = ahead & (across >= low) & (across <= high) & (down >= low) & (down <= high)
        return inside

    def keeps(self, turn: Turn) -> Flags:
        kept: Flags = self._seen[self._lives.of(turn)]
        return kept
