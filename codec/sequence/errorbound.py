"""How far a stream may be from the files that it is made of, and how far it was."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from codec.arrays import Doubles
from codec.errors import InvalidError
from codec.kernel import kernel
from codec.lattice.lattice import COLOURS, LARGEST, TURNS, Lattice, States
from codec.lattice.quantise import MAX_OPACITY_LEVELS
from codec.splats import MAX_SH_DEGREE, sh_count

HOLD = 0.75
"""Steps that a value may be off before it is sent again; a new one is rounded, so half a step off.
Above 0.5, so that noise about the middle between two steps is not sent."""

KINDS = ("position", "size", "turn", "colour", "opacity")

COARSER_POSITION, FINER_SIZE, FINER_COLOUR, FINER_OPACITY = 2.1, 3.0, 5.0, 2.0
"""How the errors of a layer differ from those of each Gaussian by itself, at SH degree 3. Found by
drawing: positions change all the time, so each of their bits costs most."""

FLAT = 3.0
"""An axis thinner than the usual size by more than this power of e, 1/20, counts as flat."""

SIZES = 2 * LARGEST + 1
"""Steps between the smallest and the largest log-scale."""

TINY_M = 1e-12

FINEST_OPACITY = HOLD / (MAX_OPACITY_LEVELS - 1)
"""The smallest error of an opacity that a stream can keep."""


@dataclass(frozen=True, slots=True)
class ErrorBound:
    """Largest errors of a Gaussian against the same frame's file. A Gaussian that would exceed one
    is sent at full precision."""

    position: float = 0.067
    """Largest error of each coordinate, as a share of the usual size of a Gaussian: the geometric
    mean of its two larger standard deviations, in the file where that is least."""
    size: float = 0.09
    """Largest error of the natural logarithm of each axis's standard deviation: 0.09 is 9 %. An
    axis thinner than the lattice holds counts as the thinnest that it holds."""
    turn: float = 0.0125
    """Largest error of the components x, y, z of the unit quaternion: 0.0125 is 1.4 degrees."""
    colour: float = 0.042
    """Largest error of Y, Co, Cg of each spherical harmonic coefficient: 0.042 is 0.012 of the
    whole range."""
    opacity: float = 0.02
    """Largest error of the opacity, which lies between 0 and 1."""
    finer: float = 1.0
    """Divisor of all these errors: 2 halves each of them."""

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not 0 < value < float("inf"):
                raise InvalidError(f"error {field.name} {value:g}: choose more than 0")
        if self.of("opacity") < FINEST_OPACITY * (1 - 1e-9):
            raise InvalidError(
                f"error opacity {self.of('opacity'):g}: choose {FINEST_OPACITY:.4f} or more, "
                "the finest step of a stream"
            )

    def of(self, kind: str) -> float:
        """The bound of one of KINDS."""
        return float(getattr(self, kind)) / self.finer

    def coarser(self, factor: float) -> ErrorBound:
        """These bounds times `factor`, but for the opacity's."""
        return replace(
            self,
            position=self.position * factor,
            size=self.size * factor,
            turn=self.turn * factor,
            colour=self.colour * factor,
        )

    def in_layer(
        self, coarseness: float, sh_degree: int, reach: float, spread: float
    ) -> ErrorBound:
        """The bounds of a layer whose Gaussians show 1 / `coarseness` as much as the usual one, so
        that all kinds of errors show about equally in a picture.

        reach: the largest magnitude of a harmonic coefficient, which one byte must hold; spread: of
        the log-scales, the same.
        """
        size = max(self.size * coarseness / FINER_SIZE, HOLD * spread / SIZES * self.finer)
        # The errors of all coefficients of a colour add up.
        finer = FINER_COLOUR * (sh_count(sh_degree) / sh_count(MAX_SH_DEGREE))
        colour = max(self.colour * coarseness / finer, HOLD * reach / LARGEST * self.finer)
        return replace(
            self,
            position=self.position * coarseness * COARSER_POSITION,
            size=min(size, self.size * max(coarseness, 1)),
            turn=self.turn * coarseness,
            colour=min(colour, self.colour * max(coarseness, 1)),
            opacity=max(self.opacity / FINER_OPACITY, FINEST_OPACITY * self.finer),
        )

    def lattice(self, size_m: float, lowest: float, highest: float) -> Lattice:
        """The lattice that keeps these bounds.

        size_m: the usual size of a Gaussian; lowest, highest: of all log-scales. Raises
        InvalidError for steps that no stream has.
        """
        log_scale = max(self.of("size") / HOLD, spread_of(size_m, lowest, highest) / SIZES)
        base = 0.0
        if highest > LARGEST * log_scale or lowest < -(LARGEST + 1) * log_scale:
            # What is large must fit; what is too thin is flat.
            base = (np.ceil(highest / log_scale) - LARGEST) * log_scale
        levels = 1 + int(np.ceil(HOLD / self.of("opacity") - 1e-9))
        return Lattice(
            max(self.of("position") * size_m / HOLD, 1e-6),
            log_scale,
            self.of("turn") / HOLD,
            self.of("colour") / HOLD,
            max(levels, 2),
            base,
        )


def spread_of(size_m: float, lowest: float, highest: float) -> float:
    """The range of log-scales that a lattice must hold, without the thin axes of flat Gaussians;
    see `ErrorBound.lattice`."""
    return highest - max(lowest, float(np.log(max(size_m, TINY_M))) - FLAT)


def steps_of(lattice: Lattice) -> Doubles:
    """(5,) the steps of KINDS, in the units of ErrorBound, but those of positions in metres."""
    steps = lattice.position_m, lattice.log_scale, lattice.rotation, lattice.colour
    return np.array([*steps, 1 / (lattice.opacity_levels - 1)])


def errors_of(values: Doubles, states: States) -> Doubles:
    """(N, 5) how far each of KINDS in `states` is from (N, 3 + A) values of positions and
    attributes, in steps. What is thinner than a lattice holds is flat, and right."""
    errors = np.zeros((len(states), len(KINDS)))
    _errors(values, states.positions, states.attributes, errors)
    return errors


@kernel(nogil=True)
def _errors(values, positions, attributes, errors):  # type: ignore[no-untyped-def]
    """Fills the last, which begins as zeros."""
    last = attributes.shape[1] - 1
    for i in range(values.shape[0]):
        for axis in range(3):
            errors[i, 0] = max(errors[i, 0], abs(values[i, axis] - positions[i, axis]))
        for a in range(last):
            value = values[i, 3 + a]
            kind = 1 + (a >= TURNS) + (a >= COLOURS)
            if kind == 1:
                value = max(value, -128.0)
            errors[i, kind] = max(errors[i, kind], abs(value - np.int8(attributes[i, a])))
        errors[i, 4] = abs(values[i, 3 + last] - attributes[i, last])
