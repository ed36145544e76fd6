"""Mathematics of relocation."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from codec.camera import Camera
from player.render.recipe import ALPHA_MAX
from trainer.fit.mcmc import MAX_COPIES, relocate, split_opacity_and_scale
from trainer.step.raster import Parameters, View, render
from trainer.step.scalebound import CameraSpread, bound_scales


@given(st.floats(0.01, 0.99), st.integers(1, MAX_COPIES))
def test_copies_together_are_as_opaque_as_the_one_they_replace(opacity: float, copies: int) -> None:
    new, factor = split_opacity_and_scale(np.array([opacity]), np.array([copies]), 1e-9)
    assert 1 - (1 - new[0]) ** copies == pytest.approx(opacity, rel=1e-6)
    if copies == 1:
        assert factor[0] == pytest.approx(1)
    else:
        assert 0 < factor[0] <= 1


@given(st.floats(0.05, 0.95), st.integers(2, 12))
def test_the_scale_keeps_the_integral_of_a_line_through_the_gaussian(
    opacity: float, copies: int
) -> None:
    """The property of the formula, checked by quadrature: the blended opacity of the copies,
    integrated along a line through their common centre, is that of the old Gaussian."""
    new, factor = split_opacity_and_scale(np.array([opacity]), np.array([copies]), 1e-9)
    x = np.linspace(-12, 12, 20001)
    before = opacity * np.exp(-0.5 * x**2)
    after = 1 - (1 - new[0] * np.exp(-0.5 * (x / factor[0]) ** 2)) ** copies
    assert after.sum() == pytest.approx(before.sum(), rel=1e-4)


def lone_gaussian(rows: int, opacity: float) -> Parameters:
    values = Parameters.zeros(rows, 0)
    values.quats[:, 0] = 1
    values.log_scales[:] = np.log(0.3)
    values.logit_opacities[:] = np.log(opacity / (1 - opacity))
    values.means[:] = (0, 0, 3)
    values.sh[:, 0] = 1.0
    return values


def test_relocation_keeps_the_rendered_picture() -> None:
    camera = Camera("c", 64, 64, 60.0, 60.0, 32.0, 32.0, np.eye(4))
    view = View.prepare(camera, 0.2)
    for opacity in (0.3, 0.7, 0.95):
        values = lone_gaussian(4, opacity)
        values.means[1:] = (50, 50, 3)  # the dead ones, elsewhere
        values.logit_opacities[1:] = -9
        rows = np.arange(4, dtype=np.int32)
        before = render(values, rows, view).picture
        targets = relocate(values, np.arange(1, 4), np.array([0]), 0.005, np.random.default_rng(0))
        assert (targets == 0).all()
        after = render(values, rows, view).picture
        assert opacity < ALPHA_MAX
        # The formula keeps the integral along a line, not each pixel: a few per cent at the rim.
        assert np.abs(after - before).max() < 0.11 * before.max()
        through_centre = before[0, 31].sum()
        assert after[0, 31].sum() == pytest.approx(through_centre, rel=0.03)


def test_relocation_takes_the_opaque_more_often_and_touches_no_one_else() -> None:
    values = lone_gaussian(300, 0.5)
    values.logit_opacities[:100] = -9  # dead
    values.logit_opacities[100:200] = np.log(0.1 / 0.9)
    values.logit_opacities[200:] = np.log(0.9 / 0.1)
    before = values.log_scales.copy()
    targets = relocate(values, np.arange(100), np.arange(100, 300), 0.005, np.random.default_rng(1))
    assert 80 < (targets >= 200).sum() <= 100  # expected 90
    spared = np.setdiff1d(np.arange(100, 300), targets)
    assert (values.log_scales[spared] == before[spared]).all()
    for dead, target in enumerate(targets):
        assert values.logit_opacities[dead] == values.logit_opacities[target]
        assert (values.log_scales[dead] == values.log_scales[target]).all()


def test_relocation_without_dead_or_living_does_nothing() -> None:
    values = lone_gaussian(4, 0.5)
    before = [a.copy() for a in values.arrays]
    rng = np.random.default_rng(0)
    none = np.zeros(0, np.int64)
    assert len(relocate(values, none, np.arange(4), 0.005, rng)) == 0
    assert len(relocate(values, np.arange(4), none, 0.005, rng)) == 0
    for a, b in zip(values.arrays, before, strict=True):
        assert (a == b).all()


def camera_at(x: float, y: float, z: float) -> Camera:
    pose = np.eye(4)
    pose[:3, 3] = (-x, -y, -z)
    return Camera("c", 64, 64, 60.0, 60.0, 32.0, 32.0, pose)


def test_distances_are_means_over_the_cameras() -> None:
    rng = np.random.default_rng(5)
    places, means = rng.normal(size=(7, 3)), rng.normal(size=(20, 3)).astype(np.float32)
    spread = CameraSpread.of([camera_at(*place) for place in places])
    apart = means[:, None] - places
    expected = np.sqrt((apart**2).sum(axis=2).mean(axis=1))
    np.testing.assert_allclose(spread.distances_m(means), expected, rtol=1e-6)


def test_scales_are_bounded_where_they_are_asked_to_be_and_nowhere_else() -> None:
    values = lone_gaussian(4, 0.5)
    values.means[:] = [(0, 0, 0), (0, 0, 30), (0, 0, 0), (0, 0, 0)]
    values.log_scales[:] = np.log([(9, 0.1, 1), (9, 9, 0.1), (9, 9, 9), (0.1, 0.1, 0.1)])
    spread = CameraSpread.of([camera_at(3, 0, 0), camera_at(-3, 0, 0)])
    before = values.log_scales.copy()
    bound_scales(values, np.array([0, 1, 3], np.int32), spread, 0.2)
    scales = np.exp(values.log_scales)
    np.testing.assert_allclose(scales[0], (0.6, 0.1, 0.6), rtol=1e-5)
    np.testing.assert_allclose(scales[1], (0.2 * np.hypot(30, 3),) * 2 + (0.1,), rtol=1e-5)
    assert (values.log_scales[2:] == before[2:]).all()
