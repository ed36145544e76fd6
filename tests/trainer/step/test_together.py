"""Coherent motion: the Gaussians of a cell get a common gradient."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from trainer.step.together import cells_of, move_together


@given(st.integers(1, 60), st.floats(0.05, 3), st.integers(0, 99))
def test_a_cell_holds_what_lies_in_its_cube(count: int, size_m: float, seed: int) -> None:
    means = np.random.default_rng(seed).normal(size=(count, 3)).astype(np.float32)
    cells = cells_of(means, size_m)
    cubes = [tuple(cube) for cube in np.floor(means / np.float32(size_m)).astype(int)]
    for i in range(count):
        for j in range(count):
            assert (cells[i] == cells[j]) == (cubes[i] == cubes[j])


def test_gradients_are_summed_over_those_that_move() -> None:
    gradients = np.arange(12, dtype=np.float32).reshape(4, 3)
    before = gradients.copy()
    cells = np.array([0, 1, 0, 0], np.int32)
    move_together(gradients, np.array([0, 1, 3], np.int32), cells)
    assert (gradients[0] == before[0] + before[3]).all()
    assert (gradients[3] == gradients[0]).all()
    assert (gradients[1] == before[1]).all()
    assert (gradients[2] == before[2]).all()  # kept: it stands still


def test_noise_averages_out_and_motion_stays() -> None:
    rng = np.random.default_rng(0)
    gradients = rng.normal((0.3, 0, 0), 1, (400, 3)).astype(np.float32)
    move_together(gradients, np.arange(400, dtype=np.int32), np.zeros(400, np.int32))
    direction = gradients[0] / np.linalg.norm(gradients[0])
    assert direction[0] > 0.95
