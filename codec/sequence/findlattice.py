"""The lattice that Gaussians lie on already, as those of another stream do.

Taking it again loses nothing, where another one of the same fineness would round every number once
more.
"""

from __future__ import annotations

import numpy as np

from codec.errors import InvalidError
from codec.lattice.lattice import (
    COLOURS,
    SCALES,
    TURNS,
    Flags,
    Lattice,
    States,
    dequantise,
    num_attributes,
    round_values,
)
from codec.lattice.quantise import MAX_OPACITY_LEVELS, opacity_logits, to_luma
from codec.pose import Doubles
from codec.splats import Floats, Splats

ENOUGH = 0.9
"""Share of the Gaussians that lie on a lattice that is taken; the others escaped from it."""

MAX_SAMPLES = 1 << 14
"""Gaussians looked at: as good as all of them."""

OFTEN = 0.8
"""Share of the numbers that must occur again and again for the others not to count."""

MANY = 2000
"""Among this many numbers, two may be equal by chance."""

CANDIDATES = 8
"""Differences tried as a step: the most frequent ones, and the smallest."""

NEAR = 0.02
"""Steps that a number on the lattice may be off, after the rounding of f32."""


def as_given(splats: Splats, lattice: Lattice) -> tuple[States, Flags]:
    """`splats` as integers in the form that they have, and (N,) which of them are these bit by
    bit when decoded; the others mean nothing."""
    count, degree = len(splats), splats.sh_degree
    values = np.empty((count, 3 + num_attributes(degree)))
    values[:, :3] = splats.means.astype(np.float64) / lattice.position_m
    attributes = values[:, 3:]
    scales = splats.log_scales.astype(np.float64)
    attributes[:, SCALES:TURNS] = (scales - lattice.log_scale_base) / lattice.log_scale
    attributes[:, TURNS:COLOURS] = splats.quats[:, 1:].astype(np.float64) / lattice.rotation
    colours = to_luma(splats.sh.astype(np.float64)).transpose(0, 2, 1) / lattice.colour
    attributes[:, COLOURS:-1] = colours.reshape(count, -1)
    attributes[:, -1] = splats.opacities.astype(np.float64) * (lattice.opacity_levels - 1)
    states, _ = round_values(values, lattice)
    same = np.ones(count, np.bool_)
    for a, b in zip(dequantise(states, lattice).arrays, splats.arrays, strict=True):
        same &= (a == b).reshape(count, -1).all(axis=1)
    return states, same


def find_lattice(splats: Splats) -> Lattice | None:
    """The lattice of `splats`; None if there is none, or too few Gaussians show it."""
    if not len(splats):
        return None
    splats = splats.take(slice(None, None, 1 + len(splats) // MAX_SAMPLES))
    levels = _opacity_levels(splats)
    colours = to_luma(splats.sh.astype(np.float64))
    steps = [
        _step(values.astype(np.float64).ravel())
        for values in (splats.means, splats.log_scales, splats.quats[:, 1:], colours)
    ]
    position_m, log_scale, rotation, colour = (step or 0.0 for step in steps)
    if levels is None:
        return None
    try:
        lattice = Lattice(position_m, log_scale, rotation, colour, levels)
    except InvalidError:
        return None
    return lattice if as_given(splats, lattice)[1].mean() >= ENOUGH else None


def _opacity_levels(splats: Splats) -> int | None:
    """The fewest levels whose logits are those of `splats`."""
    logits, counts = np.unique(splats.logit_opacities, return_counts=True)
    wanted = ENOUGH * len(splats)
    for levels in range(2, MAX_OPACITY_LEVELS + 1):
        if counts[np.isin(logits, opacity_logits(levels))].sum() >= wanted:
            return levels
    return None


def _step(values: Doubles) -> float | None:
    """The largest step, f32, that almost all of `values` are multiples of, as f32."""
    numbers = np.sort(abs(values[values != 0]))
    if not len(numbers):
        return None
    # Numbers that differ by the rounding of f32 are one.
    apart = np.flatnonzero(np.diff(numbers, prepend=-np.inf) > numbers[-1] * 2.0**-22)
    counts = np.diff(apart, append=len(numbers))
    numbers = np.add.reduceat(numbers, apart) / counts
    # What is there again and again is on the lattice, if that is most.
    often = counts > 1 + counts.sum() // MANY
    telling = numbers[often] if counts[often].sum() >= OFTEN * counts.sum() else numbers
    gaps = np.sort(np.diff(telling, prepend=0))
    classes = np.rint(np.log(gaps) * 200)
    _, first, frequency = np.unique(classes, return_index=True, return_counts=True)
    means = np.add.reduceat(gaps, first) / frequency
    frequent = np.argsort(-frequency, kind="stable")[:CANDIDATES]
    for candidate in means[np.union1d(frequent, np.arange(min(CANDIDATES, len(means))))][::-1]:
        step = _refined(telling, float(candidate))
        off = counts[~_is_on(numbers, step)].sum()
        if off <= (1 - ENOUGH) * len(values):  # zeros are multiples, too
            return _exact(values.astype(np.float32), np.float32(step))
    return None


def _exact(values: Floats, step: np.float32) -> float:
    """`step` or one of its neighbours, whose multiples, in f32, are the most of `values`."""
    around = [np.nextafter(step, np.float32(0)), step, np.nextafter(step, np.float32(np.inf))]
    return float(max(around, key=lambda one: int((np.rint(values / one) * one == values).sum())))


def _refined(numbers: Doubles, step: float) -> float:
    """`step` fitted to its multiples, first the near ones, then ever farther ones, which are more
    exact."""
    reaches = 16.0 * 4.0 ** np.arange(1 + max(0, int(np.log2(numbers[-1] / step) / 2)))
    for reach, near in *((reach, 0.1) for reach in reaches), (np.inf, NEAR), (np.inf, NEAR / 20):
        used = numbers[(numbers < reach * step) & _is_on(numbers, step, near)]
        multiples = np.rint(used / step)
        total = (multiples**2).sum()
        if total > 0:
            step = float((used * multiples).sum() / total)
    return step


def _is_on(numbers: Doubles, step: float, near: float = NEAR) -> Flags:
    """(N,) which of `numbers` are multiples of `step` to `near` steps, as far as f32 is precise."""
    multiples = numbers / step
    slack = near + multiples * 2.0**-23
    on: Flags = (abs(multiples - np.rint(multiples)) < slack) & (slack < 0.25)
    return on
