"""Gaussians to integers on the lattice of a stream (`quantise`) and back (codec/FORMAT.md, section
8); and as bytes with every float32 as it was given.

Rule: what makes floats of integers does the operations that FORMAT.md states, in its order and
precision, so that any decoder gives the same bits. What a quantiser chooses is free.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from codec.arrays import Bytes, Doubles, Flags, Floats, Ints
from codec.errors import CorruptError, InvalidError
from codec.kernel import kernel
from codec.splats import SH_C0, Splats, array_shapes, sh_count

from .forms import (
    BASE_COLOUR,
    BASE_LOG_SCALE,
    BASE_ROTATION,
    MAX_OPACITY_LEVELS,
    canonical,
    from_luma,
    nearest_form,
    opacity_logits,
    position_step_m,
)

POSITION_LIMIT = 1 << 23
"""Magnitude that no integer coordinate reaches, so that f32 holds it and any difference exactly."""

MIN_STEP, MAX_STEP = 1e-6, 1e6
MAX_BASE = 1e3

SCALES, TURNS, COLOURS = 0, 3, 6
"""Where the attributes of a kind begin. The opacity is the last attribute."""

LARGEST = 127
"""The integer of the largest log-scale."""

OPACITY_LEVELS = 41
"""Coarse: opacity changes most from slice to slice, and shows least."""

MAX_HOLD = 4
"""Steps by which a number that is held may miss."""

TAME = 1e30
"""Magnitude from which a value is not tried on the lattice."""


def num_attributes(sh_degree: int) -> int:
    """One-byte attributes of a Gaussian: 3 scales, 3 turns, 3 K colours, the opacity."""
    return COLOURS + 3 * sh_count(sh_degree) + 1


@dataclass(frozen=True, slots=True)
class Lattice:
    """The distances between neighbouring values; raises InvalidError for one out of bounds.

    They are float32 numbers, so that a writer calculates with what a reader reads.
    """

    position_m: float
    log_scale: float
    rotation: float
    """Step of a quaternion component."""
    colour: float
    """Step of a spherical harmonic coefficient of Y, Co or Cg."""
    opacity_levels: int
    """Opacities from 0 to 1, both included."""
    log_scale_base: float = 0.0
    """The log-scale of the integer 0."""

    def __post_init__(self) -> None:
        for name in ("position_m", "log_scale", "rotation", "colour"):
            step = getattr(self, name)
            if not MIN_STEP <= step <= MAX_STEP and step != np.float32(MIN_STEP):
                raise InvalidError(f"lattice: {name} {step:g} is not in {MIN_STEP:g}..{MAX_STEP:g}")
            object.__setattr__(self, name, float(np.float32(step)))
        if not abs(self.log_scale_base) <= MAX_BASE:
            raise InvalidError(
                f"lattice: log_scale_base {self.log_scale_base:g} is not in {-MAX_BASE:g}.."
                f"{MAX_BASE:g}"
            )
        object.__setattr__(self, "log_scale_base", float(np.float32(self.log_scale_base)))
        if not 2 <= self.opacity_levels <= MAX_OPACITY_LEVELS:
            raise InvalidError(
                f"lattice: opacity_levels {self.opacity_levels} is not in 2..{MAX_OPACITY_LEVELS}"
            )

    def floats(self) -> Floats:
        """(5,) float32: the steps and the base of the log-scales."""
        steps = self.position_m, self.log_scale, self.rotation, self.colour
        return np.array((*steps, self.log_scale_base), np.float32)

    @staticmethod
    def suiting(splats: Splats, grown: float = 1.0) -> Lattice:
        """A lattice for a stream of Gaussians like `splats`. The step of positions follows their
        sizes, for a scene may have any scale; grown: how much larger they will be."""
        return Lattice(
            position_step_m(splats) * grown,
            BASE_LOG_SCALE,
            BASE_ROTATION,
            BASE_COLOUR,
            OPACITY_LEVELS,
        )

    def coarser(self, factor: float) -> Lattice:
        """The lattice with steps of `factor` times the size, but for the opacity. Where a base
        makes the largest log-scale fit, it still does."""
        log_scale, base = self.log_scale * factor, self.log_scale_base
        return replace(
            self,
            position_m=self.position_m * factor,
            log_scale=log_scale,
            log_scale_base=base + LARGEST * (self.log_scale - log_scale) if base else base,
            rotation=self.rotation * factor,
            colour=self.colour * factor,
        )


@dataclass(frozen=True, slots=True)
class States:
    """N Gaussians as integers."""

    positions: Ints  # (N, 3) int32, magnitude below POSITION_LIMIT
    attributes: Bytes  # (N, 7 + 3 K) uint8: two's complement, but the opacity, the last, unsigned

    def __len__(self) -> int:
        return len(self.positions)

    @property
    def sh_degree(self) -> int:
        return math.isqrt((self.attributes.shape[1] - COLOURS - 1) // 3) - 1

    @staticmethod
    def zeros(count: int, sh_degree: int) -> States:
        return States(
            np.zeros((count, 3), np.int32), np.zeros((count, num_attributes(sh_degree)), np.uint8)
        )

    def take(self, rows: npt.NDArray[np.integer] | Flags | slice) -> States:
        """The states at `rows`, in that order."""
        if isinstance(rows, slice):
            return States(self.positions[rows], self.attributes[rows])
        if rows.dtype == np.bool_:
            rows = np.flatnonzero(rows)
        # Several times as fast as indexing with an array.
        return States(self.positions.take(rows, axis=0), self.attributes.take(rows, axis=0))

    def put(self, rows: npt.NDArray[np.integer] | slice, states: States) -> None:
        """Replaces those at `rows`."""
        if isinstance(rows, slice):
            self.positions[rows], self.attributes[rows] = states.positions, states.attributes
            return
        _put(rows, states.positions, states.attributes, self.positions, self.attributes)

    def numbers(self) -> Doubles:
        """(N, 3 + A) float64: the integers, signed as they are meant."""
        numbers = np.empty((len(self), 3 + self.attributes.shape[1]))
        numbers[:, :3] = self.positions
        numbers[:, 3:] = self.attributes.view(np.int8)
        numbers[:, -1] = self.attributes[:, -1]
        return numbers

    def differ(self, others: States) -> Flags:
        """(N,) where `others`, as many, are not the same."""
        found = np.empty(len(self), np.bool_)
        _differ(self.positions, self.attributes, others.positions, others.attributes, found)
        return found

    def copy(self) -> States:
        return States(self.positions.copy(), self.attributes.copy())

    @staticmethod
    def concatenate(parts: Sequence[States]) -> States:
        return States(
            np.concatenate([part.positions for part in parts]),
            np.concatenate([part.attributes for part in parts]),
        )


@kernel(nogil=True)
def _put(rows, positions, attributes, to_positions, to_attributes):  # type: ignore[no-untyped-def]
    for i in range(rows.shape[0]):
        for axis in range(3):
            to_positions[rows[i], axis] = positions[i, axis]
        for a in range(attributes.shape[1]):
            to_attributes[rows[i], a] = attributes[i, a]


@kernel(nogil=True)
def _differ(positions, attributes, other_positions, other_attributes, found):  # type: ignore[no-untyped-def]
    for i in range(found.shape[0]):
        bits = 0
        for axis in range(3):
            bits |= positions[i, axis] ^ other_positions[i, axis]
        for a in range(attributes.shape[1]):
            bits |= attributes[i, a] ^ other_attributes[i, a]
        found[i] = bits != 0


@kernel(nogil=True)
def _luma_steps(sh, darkest, step, values):  # type: ignore[no-untyped-def]
    """Fills (N, 3 K) values: all Y, then Co, Cg of (N, K, 3) coefficients, in steps."""
    coefficients = sh.shape[1]
    for i in range(sh.shape[0]):
        for k in range(coefficients):
            red = max(np.float64(sh[i, k, 0]), darkest)
            green = max(np.float64(sh[i, k, 1]), darkest)
            blue = max(np.float64(sh[i, k, 2]), darkest)
            values[i, k] = (red + 2 * green + blue) / 4 / step
            values[i, coefficients + k] = (red - blue) / 2 / step
            values[i, 2 * coefficients + k] = (2 * green - red - blue) / 4 / step


def lattice_values(splats: Splats, lattice: Lattice, before: States | None = None) -> Doubles:
    """(N, 3 + A) float64: position and attributes of `splats` in steps of `lattice`, not rounded.

    Of the equal forms of a Gaussian it is the one nearest to `before`, what the same Gaussians
    were; without it the canonical one.
    """
    count, coefficients = len(splats), splats.sh.shape[1]
    with np.errstate(over="ignore", invalid="ignore"):
        means = splats.means.astype(np.float64)
        if before is None:
            scales, quats = canonical(splats.log_scales, splats.quats)
        else:
            signed = before.attributes.view(np.int8).astype(np.float64)
            scales, quats = nearest_form(
                splats.log_scales,
                splats.quats,
                signed[:, SCALES:TURNS] * lattice.log_scale + lattice.log_scale_base,
                signed[:, TURNS:COLOURS] * lattice.rotation,
            )
        values = np.empty((count, 3 + COLOURS + 3 * coefficients + 1))
        values[:, :3] = means / lattice.position_m
        attributes = values[:, 3:]
        attributes[:, SCALES:TURNS] = (scales - lattice.log_scale_base) / lattice.log_scale
        attributes[:, TURNS:COLOURS] = quats[:, 1:] / lattice.rotation
        # Colour below black is drawn black; without view dependence nothing is lost by this.
        darkest = -0.5 / SH_C0 if splats.sh_degree == 0 else -np.inf
        _luma_steps(splats.sh, darkest, lattice.colour, attributes[:, COLOURS:-1])
        attributes[:, -1] = splats.opacities.astype(np.float64) * (lattice.opacity_levels - 1)
    return np.clip(values, -TAME, TAME, out=values)


def quantise(
    splats: Splats, lattice: Lattice, before: States | None = None, hold: float = 0.5
) -> tuple[States, Flags]:
    """`splats` on the lattice, and (N,) which of them fit; the others must escape.

    before: what the same Gaussians were. Of the equal forms of a Gaussian the one nearest to it is
    taken, and a value within `hold` steps of the one before stays that one; from 0.5, which rounds
    to the nearest, upwards differences get fewer and errors larger; at most MAX_HOLD.
    """
    if not 0 <= hold <= MAX_HOLD:
        raise InvalidError(f"lattice: hold {hold:g} is not in 0..{MAX_HOLD}")
    return round_values(lattice_values(splats, lattice, before), lattice, before, hold)


def round_values(
    values: Doubles, lattice: Lattice, before: States | None = None, hold: float = 0.5
) -> tuple[States, Flags]:
    """`lattice_values` as integers, and which rows fit; see `quantise`."""
    count, width = values.shape
    states = States(np.empty((count, 3), np.int32), np.empty((count, width - 3), np.uint8))
    fits = np.empty(count, np.bool_)
    if before is None or hold <= 0.5:
        before, hold = States.zeros(count, states.sh_degree), -1.0
    _round(
        values, lattice.opacity_levels, hold, before.positions, before.attributes,
        states.positions, states.attributes, fits,
    )  # fmt: skip
    return states, fits


@kernel(nogil=True)
def _nearest(value, held, hold):  # type: ignore[no-untyped-def]
    return held if abs(value - held) <= hold else np.rint(value)


@kernel(nogil=True)
def _round(  # type: ignore[no-untyped-def]
    values, levels, hold, old_positions, old_attributes, positions, attributes, fits
):
    """Fills the last three. A hold below 0 holds nothing."""
    last = attributes.shape[1] - 1
    most = np.float64(POSITION_LIMIT - 1)
    for i in range(values.shape[0]):
        misses = 0
        for axis in range(3):
            number = _nearest(values[i, axis], np.float64(old_positions[i, axis]), hold)
            inside = min(max(number, -most), most)
            misses += number != inside
            positions[i, axis] = np.int32(inside)
        for a in range(last):
            held = np.float64(np.int8(old_attributes[i, a]))
            number = _nearest(values[i, 3 + a], held, hold)
            inside = min(max(number, -128.0), 127.0)
            # An axis thinner than the lattice holds is flat all the same.
            misses += (number != inside) & ((a >= TURNS) | (number > 0))
            attributes[i, a] = np.uint8(np.int32(inside))
        number = _nearest(values[i, 3 + last], np.float64(old_attributes[i, last]), hold)
        inside = min(max(number, 0.0), levels - 1.0)
        attributes[i, last] = np.uint8(np.int32(inside))
        fits[i] = misses == 0 and number == inside


def dequantise(states: States, lattice: Lattice) -> Splats:
    """The Gaussians that `states` mean."""
    arrays = tuple(np.empty(s, np.float32) for s in array_shapes(len(states), states.sh_degree))
    logits = opacity_logits(lattice.opacity_levels)
    # With NUMBA_DISABLE_JIT the kernel is numpy, which warns of an overflow.
    with np.errstate(over="ignore", invalid="ignore"):
        dequantise_into(states.positions, states.attributes, lattice.floats(), logits, *arrays)
    return Splats(*arrays)


@kernel(nogil=True, error_model="numpy")
def dequantise_into(  # type: ignore[no-untyped-def]
    positions, attributes, steps, logits, means, log_scales, quats, logit_opacities, sh
):
    """Fills a row of the last five for each row of the first two. Without fastmath: FORMAT.md says
    the order of every operation. steps: `Lattice.floats`."""
    position_m, log_scale, rotation, colour = steps[0], steps[1], steps[2], steps[3]
    log_scale_base = steps[4]
    one, zero = np.float32(1), np.float32(0)
    coefficients = sh.shape[1]
    for i in range(positions.shape[0]):
        for axis in range(3):
            means[i, axis] = np.float32(positions[i, axis]) * position_m
            size = np.float32(np.int8(attributes[i, axis])) * log_scale
            log_scales[i, axis] = size + log_scale_base
        x = np.float32(np.int8(attributes[i, 3])) * rotation
        y = np.float32(np.int8(attributes[i, 4])) * rotation
        z = np.float32(np.int8(attributes[i, 5])) * rotation
        quats[i, 0] = np.sqrt(max(one - ((x * x + y * y) + z * z), zero))
        quats[i, 1], quats[i, 2], quats[i, 3] = x, y, z
        for k in range(coefficients):
            sh[i, k, 0], sh[i, k, 1], sh[i, k, 2] = from_luma(
                np.float32(np.int8(attributes[i, 6 + k])) * colour,
                np.float32(np.int8(attributes[i, 6 + coefficients + k])) * colour,
                np.float32(np.int8(attributes[i, 6 + 2 * coefficients + k])) * colour,
            )
        logit_opacities[i] = logits[attributes[i, 6 + 3 * coefficients]]


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
