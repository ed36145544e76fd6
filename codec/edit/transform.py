"""Transform: the scene is scaled, turned and moved, with its cameras and bounds; and the regions of
space of a crop.

Scaling alters only the lattice, moving adds the same integers to all positions, and a turn that
maps axes to axes permutes integers. Only other turns round each number anew.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
import tyro

from codec.arrays import Doubles, Flags
from codec.camera import Camera, rotation_about
from codec.errors import InvalidError
from codec.lattice.lattice import (
    COLOURS,
    POSITION_LIMIT,
    SCALES,
    TURNS,
    Lattice,
    States,
    dequantise,
    quantise,
)
from codec.similarity import Similarity, turned_harmonics
from codec.splats import Splats, sh_count
from codec.stream.manifest import Manifest
from codec.stream.sound import Key

from .walk import HOLD, Edit


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

    def holds(self, means: Doubles) -> Flags:
        """(N,) which of (N, 3) `means` are inside."""
        outside = np.maximum(self.lower - means, means - self.upper).max(axis=1, initial=-np.inf)
        inside: Flags = outside <= 0
        return inside

    def box(self) -> tuple[Doubles, Doubles]:
        """(3,) lower and upper corner, metres."""
        return self.lower, self.upper


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

    def holds(self, means: Doubles) -> Flags:
        """(N,) which of (N, 3) `means` are inside."""
        inside: Flags = ((means - self.centre) ** 2).sum(axis=1) <= self.radius_m**2
        return inside

    def box(self) -> tuple[Doubles, Doubles]:
        """(3,) lower and upper corner, metres, of a box around it."""
        return self.centre - self.radius_m, self.centre + self.radius_m


Region = Box | Sphere


def _text(values: Doubles) -> str:
    return " ".join(f"{value:g}" for value in values)


ON_AXES = 1e-9
"""How far a turn may be from one that maps axes to axes."""


@dataclass(frozen=True, slots=True)
class TransformOptions:
    """A new place for the scene: scaled and turned about the origin, then moved."""

    scale: float = 1.0
    """Factor of all lengths."""
    turn: Annotated[tuple[float, float, float], tyro.conf.arg(metavar="X Y Z")] = (0.0, 0.0, 0.0)
    """Degrees of the turns about the world's x axis, then its y axis, then its z axis."""
    move: Annotated[tuple[float, float, float], tyro.conf.arg(metavar="X Y Z")] = (0.0, 0.0, 0.0)
    """Metres to move along the axes, after the scaling and the turns. It is rounded to a whole
    number of position steps, a fraction of a Gaussian's size, unless the turn is an oblique one."""
    about: Annotated[tuple[float, float, float], tyro.conf.arg(metavar="X Y Z")] = (0.0, 0.0, 0.0)
    """Point that scaling and turns leave in place, metres."""

    def similarity(self) -> Similarity:
        """The map. Raises InvalidError."""
        numbers = (self.scale, *self.turn, *self.move, *self.about)
        if not (all(map(math.isfinite, numbers)) and self.scale > 0):
            raise InvalidError("transform: numbers must be finite, and the scale above 0")
        turn = np.eye(3)
        for axis, degrees in zip(np.eye(3), self.turn, strict=True):
            turn = rotation_about(axis, math.radians(degrees)) @ turn
        if np.abs(turn - np.rint(turn)).max() < ON_AXES:
            turn = np.rint(turn)
        about = np.array(self.about)
        return Similarity(self.scale, turn, np.array(self.move) + about - self.scale * turn @ about)


class Transform(Edit):
    """Maps every Gaussian by a similarity."""

    def __init__(
        self, options: TransformOptions, source: Manifest, coarseness: float = 1.0
    ) -> None:
        """Raises InvalidError for a map that leaves the bounds of a lattice."""
        wanted = options.similarity()
        self._options, self._manifest = options, source
        self._wanted, self._source = wanted, source.lattice
        try:
            self._lattices = tuple(_scaled(lattice, wanted.scale) for lattice in source.lattice)
        except InvalidError as error:
            raise InvalidError(f"scale {options.scale:g}: {error}") from error
        # In whole steps of the most important layer its positions are exact.
        self._on_axes = bool((wanted.turn == np.rint(wanted.turn)).all())
        offset, step = wanted.offset, self._lattices[0].position_m
        if self._on_axes:
            offset = np.rint(offset / step) * step
        self.similarity = Similarity(wanted.scale, wanted.turn, offset)
        self._harmonics = _harmonics_matrix(wanted.turn, source.sh_degree)
        self.rounds = self.rearranges = not self._on_axes
        if self.rounds:
            self._lattices = tuple(
                replace(
                    lattice,
                    position_m=lattice.position_m * coarseness,
                    rotation=lattice.rotation * coarseness,
                )
                for lattice in self._lattices
            )

    def coarser(self, factor: float) -> Transform:
        return Transform(self._options, self._manifest, factor)

    @property
    def notes(self) -> tuple[str, ...]:
        """The move, where it was rounded."""
        if (self._wanted.offset == self.similarity.offset).all():
            return ()
        x, y, z = self.similarity.offset - self._wanted.offset
        return (f"moved        {x:+.3g} {y:+.3g} {z:+.3g} m beside what was asked: whole steps",)

    def manifest(self, source: Manifest) -> Manifest:
        """The result's manifest: `source` with lattices, cameras, bounds, near planes and
        places of sound mapped."""
        cameras, scale = tuple(map(self._camera, source.cameras)), self.similarity.scale
        corners = np.array(list(itertools.product(*np.transpose(source.bounds))))
        mapped = self._places(corners)
        sound = tuple(replace(one, keys=tuple(map(self._key, one.keys))) for one in source.sound)
        (x, y, z), (u, v, w) = mapped.min(axis=0).tolist(), mapped.max(axis=0).tolist()
        view, focus = source.view, source.focus
        if focus is not None:
            (a, b, c), *_ = self._places(np.array([focus])).tolist()
            focus = a, b, c
        return replace(
            source,
            lattice=self._lattices,
            cameras=cameras,
            view=None if view is None else self._camera(view),
            focus=focus,
            bounds=((x, y, z), (u, v, w)),
            near_m=source.near_m * scale,
            camera_near_m=tuple(near_m * scale for near_m in source.camera_near_m),
            sound=sound,
        )

    def states(self, layer: int, states: States, before: States | None) -> tuple[States, Flags]:
        if self._on_axes:
            return self._permuted(layer, states)
        mapped = self.similarity.moved(dequantise(states, self._source[layer]))
        return quantise(mapped, self._lattices[layer], before, HOLD)

    def splats(self, splats: Splats) -> Splats:
        return self.similarity.moved(splats)

    def _permuted(self, layer: int, states: States) -> tuple[States, Flags]:
        """`states` under a turn that maps axes to axes. A Gaussian is turned about its centre by
        turning its quaternion's vector and permuting its own axes, which is the same."""
        turn = self.similarity.turn
        step = self._lattices[layer].position_m
        shift = np.rint(self.similarity.offset / step)
        numbers = states.numbers()
        made = numbers.copy()
        made[:, :3] = numbers[:, :3] @ turn.T + shift
        attributes, given = made[:, 3:], numbers[:, 3:]
        attributes[:, SCALES:TURNS] = given[:, SCALES:TURNS] @ np.abs(turn).T
        attributes[:, TURNS:COLOURS] = given[:, TURNS:COLOURS] @ turn.T
        count = len(self._harmonics)
        colours = given[:, COLOURS:-1].reshape(-1, 3, count) @ self._harmonics.T
        attributes[:, COLOURS:-1] = np.rint(colours).reshape(len(states), 3 * count)
        fits: Flags = np.abs(made[:, :3]).max(axis=1, initial=0) < POSITION_LIMIT
        signed = attributes[:, :-1]
        fits = fits & ((signed >= -128) & (signed <= 127)).all(axis=1)
        made[~fits] = 0
        return (
            States(made[:, :3].astype(np.int32), made[:, 3:].astype(np.int16).astype(np.uint8)),
            fits,
        )

    def _places(self, points: Doubles) -> Doubles:
        """(N, 3) `points`, mapped."""
        one = self.similarity
        mapped: Doubles = points @ (one.scale * one.turn).T + one.offset
        return mapped

    def _key(self, key: Key) -> Key:
        """`key` of a sound's path, with its place mapped; the time stays."""
        time_s, *place = key
        x, y, z = self._places(np.array([place]))[0].tolist()
        return time_s, x, y, z

    def _camera(self, camera: Camera) -> Camera:
        w2c = camera.w2c.copy()
        w2c[:3, :3] = camera.w2c[:3, :3] @ self.similarity.turn.T
        w2c[:3, 3] = -w2c[:3, :3] @ self._places(camera.position[None])[0]
        return replace(camera, w2c=w2c)


def _scaled(lattice: Lattice, scale: float) -> Lattice:
    return replace(
        lattice,
        position_m=lattice.position_m * scale,
        log_scale_base=lattice.log_scale_base + math.log(scale),
    )


def _harmonics_matrix(turn: Doubles, sh_degree: int) -> Doubles:
    """(K, K) what a turn makes of the coefficients of a colour channel."""
    count = sh_count(sh_degree)
    unit = np.repeat(np.eye(count, dtype=np.float32)[:, :, None], 3, axis=2)
    return np.asarray(turned_harmonics(unit, turn)[:, :, 0].T, np.float64)
