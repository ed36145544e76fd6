"""The lattice of a stream is recovered from its exported files."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from codec.lattice.lattice import Lattice, dequantise, quantise
from codec.sequence.findlattice import as_given, find_lattice
from codec.splats import Splats
from tests.support.trained_like import trained_like_splats


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 1 << 20),
    grown=st.floats(0.3, 4),
    degree=st.integers(0, 2),
    log_scale=st.sampled_from([0.125, 0.1, 0.06]),
    levels=st.integers(16, 256),
    escapes=st.sampled_from([0, 0.05]),
)
def test_the_lattice_is_found_bit_by_bit(
    seed: int, grown: float, degree: int, log_scale: float, levels: int, escapes: float
) -> None:
    splats = trained_like_splats(1000, seed, degree)
    usual = Lattice.suiting(splats, grown)
    lattice = Lattice(usual.position_m, log_scale, usual.rotation, usual.colour, levels)
    states, fits = quantise(splats, lattice)
    inside = np.flatnonzero(fits)
    exact = dequantise(states.take(inside), lattice)
    exact = Splats.concatenate([exact, splats.take(slice(0, int(escapes * len(exact))))])
    found = find_lattice(exact)
    assert found is not None
    assert found.position_m == lattice.position_m
    assert (found.rotation, found.colour) == (lattice.rotation, lattice.colour)
    again, same = as_given(exact, found)
    assert same[: len(inside)].all()
    assert (again.positions[: len(inside)] == states.positions[inside]).all()
    assert abs(same.mean() - len(inside) / len(exact)) < 0.01


@pytest.mark.parametrize("count", [0, 1, 2, 30, 3000])
def test_other_gaussians_have_none(count: int) -> None:
    assert find_lattice(trained_like_splats(count)) is None


def test_gaussians_that_are_all_the_same_do_no_harm() -> None:
    splats = trained_like_splats(1).take(np.zeros(100, np.int64))
    assert find_lattice(splats) is None
    arrays = splats.arrays
    flat = Splats(np.zeros_like(arrays[0]), np.zeros_like(arrays[1]), *arrays[2:])
    assert find_lattice(flat) is None
