"""Regions of space by which Gaussians are kept or removed, perhaps others in each frame."""

from __future__ import annotations

import json
from bisect import bisect_right
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from codec.errors import CorruptError, InvalidError
from codec.files import read_bounded
from codec.lattice.lattice import Flags
from codec.pose import Doubles

MAX_FILE_BYTES = 1 << 24
"""Longest file of a region over time."""


class Region(Protocol):
    """Where centres are inside."""

    def holds(self, means: Doubles, frame: int) -> Flags:
        """(N,) which of (N, 3) `means` are inside at `frame`."""
        ...

    def box(self) -> tuple[Doubles, Doubles]:
        """(3,) lower and upper corner, metres, of a box around it in all frames."""
        ...


@dataclass(frozen=True, slots=True)
class Box:
    """A box along the axes. Raises InvalidError for one without an inside."""

    lower: Doubles  # (3,) metres
    upper: Doubles  # (3,) metres

    def __post_init__(self) -> None:
        if not (np.isfinite([self.lower, self.upper]).all() and (self.lower < self.upper).all()):
            raise InvalidError(
                f"box {_text(self.lower)} {_text(self.upper)}: the first corner must lie below the "
                "second on each axis"
            )

    def holds(self, means: Doubles, frame: int) -> Flags:
        outside = np.maximum(self.lower - means, means - self.upper).max(axis=1, initial=-np.inf)
        inside: Flags = outside <= 0
        return inside

    def box(self) -> tuple[Doubles, Doubles]:
        return self.lower, self.upper

    def numbers(self) -> Doubles:
        """(6,) what keyframes interpolate."""
        return np.concatenate([self.lower, self.upper])

    @staticmethod
    def of(numbers: Doubles) -> Box:
        """The box of (6,) `numbers`."""
        return Box(numbers[:3], numbers[3:])


@dataclass(frozen=True, slots=True)
class Sphere:
    """A ball. Raises InvalidError for one without an inside."""

    centre: Doubles  # (3,) metres
    radius_m: float

    def __post_init__(self) -> None:
        if not (np.isfinite([*self.centre, self.radius_m]).all() and self.radius_m > 0):
            raise InvalidError(
                f"sphere {_text(self.centre)} {self.radius_m:g}: the radius must be above 0"
            )

    def holds(self, means: Doubles, frame: int) -> Flags:
        inside: Flags = ((means - self.centre) ** 2).sum(axis=1) <= self.radius_m**2
        return inside

    def box(self) -> tuple[Doubles, Doubles]:
        return self.centre - self.radius_m, self.centre + self.radius_m

    def numbers(self) -> Doubles:
        """(4,) what keyframes interpolate."""
        return np.append(self.centre, self.radius_m)

    @staticmethod
    def of(numbers: Doubles) -> Sphere:
        """The sphere of (4,) `numbers`."""
        return Sphere(numbers[:3], float(numbers[3]))


SHAPES: dict[str, tuple[type[Box] | type[Sphere], int]] = {"box": (Box, 6), "sphere": (Sphere, 4)}
"""By key in a file of keyframes, with how many numbers it has."""


@dataclass(frozen=True, slots=True)
class Keyframes:
    """A box or a sphere that changes evenly from each of some frames to the next, and stays before
    the first and after the last."""

    frames: tuple[int, ...]  # rising, at least one
    numbers: Doubles  # (len(frames), 6 or 4)
    shape: type[Box] | type[Sphere]

    def at(self, frame: int) -> Box | Sphere:
        """The region of `frame`."""
        after = bisect_right(self.frames, frame)
        first, last = max(after - 1, 0), min(after, len(self.frames) - 1)
        apart = self.frames[last] - self.frames[first]
        share = (frame - self.frames[first]) / apart if apart else 0.0
        return self.shape.of((1 - share) * self.numbers[first] + share * self.numbers[last])

    def holds(self, means: Doubles, frame: int) -> Flags:
        return self.at(frame).holds(means, frame)

    def box(self) -> tuple[Doubles, Doubles]:
        corners = [self.at(frame).box() for frame in self.frames]
        return np.min([low for low, _ in corners], axis=0), np.max(
            [up for _, up in corners], axis=0
        )

    @staticmethod
    def read(path: Path) -> Keyframes:
        """The keyframes in a JSON file: a list such as [{"frame": 0, "box": [x, y, z, x, y, z]},
        ...] or the same with "sphere": [x, y, z, radius]. Raises a SwingsError that names it."""
        try:
            value = json.loads(read_bounded(path, MAX_FILE_BYTES))
        except (ValueError, RecursionError) as error:
            raise CorruptError(f"{path}: is not JSON") from error
        try:
            return _keyframes(value)
        except InvalidError as error:
            raise CorruptError(f"{path}: {error}") from error


def _keyframes(value: Any) -> Keyframes:
    if type(value) is not list or not value or any(type(entry) is not dict for entry in value):
        raise InvalidError("is not a list of at least one keyframe")
    kind = next((key for key in SHAPES if key in value[0]), None)
    if kind is None:
        raise InvalidError(f"keyframe 0 has none of {', '.join(SHAPES)}")
    shape, count = SHAPES[kind]
    frames: list[int] = []
    numbers = np.empty((len(value), count))
    for place, entry in enumerate(value):
        frame, given = entry.get("frame"), entry.get(kind)
        if type(frame) is not int or (frames and frame <= frames[-1]):
            raise InvalidError(f"keyframe {place}: frame is not an integer above the one before")
        if type(given) is not list or len(given) != count:
            raise InvalidError(f"keyframe {place}: {kind} is not {count} numbers")
        if any(type(number) not in (int, float) for number in given):
            raise InvalidError(f"keyframe {place}: {kind} holds something that is not a number")
        frames.append(frame)
        try:
            numbers[place] = given
        except OverflowError as error:
            raise InvalidError(f"keyframe {place}: a number is out of range") from error
        shape.of(numbers[place])
    return Keyframes(tuple(frames), numbers, shape)


def _text(values: Doubles) -> str:
    return " ".join(f"{value:g}" for value in values)
