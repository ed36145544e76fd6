"""Gaussians moved as one body: shapes, places and colours stay together."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from codec.errors import InvalidError
from codec.pose import Doubles, rotation_about
from codec.similarity import Similarity, half_turned, harmonics, turned_harmonics
from codec.splats import SH_C0, Splats
from tests.support.alike import shapes
from tests.support.drawn import places, rotations, same_splats
from tests.support.trained_like import trained_like_splats


def affine(linear: Doubles, offset: Doubles) -> Doubles:
    return np.block([[linear, offset[:, None]], [np.zeros(3), 1.0]])


@given(rotations, places, st.floats(0.1, 10), st.booleans())
@settings(max_examples=30, deadline=None)
def test_a_moved_body(turn: Doubles, offset: Doubles, scale: float, mirrored: bool) -> None:
    splats = trained_like_splats(20, 3, 3)
    turn = turn @ np.diag([1.0, 1.0, -1.0 if mirrored else 1.0])
    moved = Similarity.of(affine(scale * turn, offset)).moved(splats)
    wanted = scale * splats.means.astype(np.float64) @ turn.T + offset
    assert moved.means == pytest.approx(wanted, rel=1e-5, abs=1e-4)
    linear = scale * turn
    wanted = linear @ shapes(splats) @ linear.T
    assert np.abs(shapes(moved) - wanted).max() < 1e-4 * np.abs(wanted).max()
    # The colour along d is then the colour along the turned d.
    along = np.random.default_rng(4).normal(size=(10, 3))
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    before = np.einsum("jk,nkc->njc", harmonics(along), splats.sh)
    after = np.einsum("jk,nkc->njc", harmonics(along @ turn.T), moved.sh)
    assert after == pytest.approx(before, abs=1e-5)
    assert moved.logit_opacities is splats.logit_opacities


@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_half_a_turn_changes_signs_alone(axis: str) -> None:
    splats = trained_like_splats(20, 5, 3)
    turned = half_turned(splats, axis)
    assert same_splats(half_turned(turned, axis), splats)
    vector = np.array([float(name == axis) for name in "xyz"])
    full = Similarity.of(affine(rotation_about(vector, np.pi), np.zeros(3))).moved(splats)
    assert turned.means == pytest.approx(full.means, abs=1e-5)
    assert turned.sh == pytest.approx(full.sh, abs=1e-6)
    assert np.abs(shapes(turned) - shapes(full)).max() < 1e-6 * shapes(full).max()


def test_the_harmonics_are_orthonormal() -> None:
    # Points of even area on the sphere, so that a mean is an integral.
    count = 20_000
    height = 1 - (2 * np.arange(count) + 1) / count
    angle = np.pi * (1 + 5**0.5) * np.arange(count)
    radius = np.sqrt(1 - height**2)
    values = harmonics(np.stack([radius * np.cos(angle), radius * np.sin(angle), height], axis=1))
    assert values[0, 0] == pytest.approx(SH_C0)
    product = 4 * np.pi * values.T @ values / count
    assert product == pytest.approx(np.eye(16), abs=1e-4)
    sh = trained_like_splats(4, 1, 3).sh
    assert turned_harmonics(sh, np.eye(3)) == pytest.approx(sh, abs=1e-7)
    # The signs of 3D Gaussian Splatting: degree 1 is -y, z, -x.
    at_axes = harmonics(np.eye(3))[:, 1:4]
    assert np.sign(at_axes).tolist() == [[0, 0, -1], [-1, 0, 0], [0, 1, 0]]


@pytest.mark.parametrize(
    ("matrix", "says"),
    [
        (np.diag([1.0, 1.0, 2.0, 1.0]), "stretches"),
        (np.zeros((4, 4)), "stretches"),
        (np.full((4, 4), np.nan), "not finite"),
        (np.diag([1.0, 1.0, 1.0, 2.0]), "not affine"),
    ],
)
def test_a_matrix_that_does_more_is_refused(matrix: Doubles, says: str) -> None:
    with pytest.raises(InvalidError, match=says):
        Similarity.of(matrix)


def test_what_leaves_the_range_of_floats_is_refused() -> None:
    far = Similarity.of(np.diag([1e38, 1e38, 1e38, 1.0]))
    with pytest.raises(InvalidError, match="not finite"):
        far.moved(trained_like_splats(2000))
    turn = Similarity.of(affine(rotation_about(np.array([0.6, 0, 0.8]), 1), np.zeros(3)))
    huge = np.full((1, 4), np.finfo(np.float32).max)
    small = trained_like_splats(1)
    long = Splats(small.means, small.log_scales, huge, small.logit_opacities, small.sh)
    with pytest.raises(InvalidError, match="quats holds a value that is not finite"):
        turn.moved(long)
