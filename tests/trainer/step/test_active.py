"""A step that skips everything irrelevant to the trained Gaussians gives the same gradients."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from codec.camera import Camera
from player.render.project import TILE_PX
from tests.support.reference_render import scattered_splats, turned_camera
from trainer.pictures.scale import Shot
from trainer.step import raster
from trainer.step.active import with_neighbours
from trainer.step.backend import StepInput
from trainer.step.cpubackend import CpuBackend
from trainer.step.loss import Loss
from trainer.step.raster import Parameters, View, render
from trainer.step.runs import Runs

NEAR_M = 0.2
WEIGHTS = (0.2, 0.01, 0.02)


class Poisoned(CpuBackend):
    """A backend whose buffers are NaN wherever a step does not write them first."""

    def poison(self, view: View, shot: Shot) -> None:
        size = 3, view.tiles_y * TILE_PX, view.tiles_x * TILE_PX
        _, work = self._targets.take(shot)
        planes = work.pred, work.blurred, work.partials, work.gradient
        for array in (
            *planes, self._scratch.take("picture", *size),
            self._scratch.take("pair gradients", 50_000, 9),
        ):  # fmt: skip
            array[:] = np.nan


def cluster(rng: np.random.Generator, count: int, sh_degree: int) -> Parameters:
    """A wide scene whose first rows are the nearest to a point."""
    values = Parameters.zeros(count, sh_degree)
    values.means[:] = rng.uniform((-2, -2, -0.5), (2, 2, 3), (count, 3))
    values.means[:] = values.means[
        np.argsort(np.linalg.norm(values.means - values.means[0], axis=1))
    ]
    values.log_scales[:] = rng.normal(np.log(0.6 * count ** (-1 / 3)), 0.6, (count, 3))
    values.quats[:] = rng.normal(size=(count, 4))
    values.logit_opacities[:] = rng.normal(0, 1.5, count)
    values.sh[:] = rng.normal(size=values.sh.shape)
    return values


def camera_of(width: int, height: int) -> Camera:
    w2c = np.eye(4)
    w2c[2, 3] = 1.5
    return Camera("c", width, height, width / 2, width / 2, width / 2, height / 2, w2c)


@given(
    seed=st.integers(0, 10_000),
    count=st.integers(1, 1500),
    share=st.sampled_from((1.0, 0.4, 0.1, 0.02, 0.0)),
    width=st.integers(17, 330),
    height=st.integers(17, 190),
    masked=st.booleans(),
    half=st.booleans(),
)
@settings(max_examples=40, deadline=None)
def test_gradients_are_the_same_to_the_bit(
    seed: int, count: int, share: float, width: int, height: int, masked: bool, half: bool
) -> None:
    rng = np.random.default_rng(seed)
    sh_degree = seed % 4
    values = cluster(rng, count, sh_degree)
    rows = np.sort(rng.permutation(count)[: -(-9 * count // 10)]).astype(np.int32)
    size = (2 * height + 1, 2 * width) if half else (height, width)
    shot = Shot(
        rng.integers(0, 256, (*size, 3), dtype=np.uint8),
        (rng.random(size) > 0.3).astype(np.uint8) if masked else None,
    )
    shot = shot.half() if half else shot
    gain = rng.uniform(0.8, 1.2, 3).astype(np.float32)
    bias = rng.uniform(-0.1, 0.1, 3).astype(np.float32)
    view = View.prepare(camera_of(width, height), NEAR_M)

    def stepped(whole: bool) -> tuple[Loss, Parameters]:
        backend, gradients = Poisoned(*WEIGHTS), Parameters.zeros(count, sh_degree)
        backend.poison(view, shot)
        trainable = round(share * count)
        given = StepInput(values, rows, view, shot, gain, bias, trainable, whole)
        return backend.step(given, gradients), gradients

    expected, wanted = stepped(True)
    got, found = stepped(False)
    for name, a, b in zip(Parameters.__slots__, found.arrays, wanted.arrays, strict=True):
        assert np.array_equal(a, b), name
    assert expected.covered == 1
    assert expected.gain_grad is not None
    assert got.value <= expected.value * 1.0001
    if got.covered == 1:
        assert got.value == pytest.approx(expected.value, rel=1e-5)
    if share == 0:
        assert (got.value, got.covered, got.gain_grad, got.bias_grad) == (0, 0, None, None)


def test_only_tiles_that_matter_are_drawn() -> None:
    rng = np.random.default_rng(3)
    values, view = cluster(rng, 2000, 0), View.prepare(camera_of(320, 190), NEAR_M)
    rows = np.arange(2000, dtype=np.int32)
    full = render(values, rows, view)
    assert full.active is None
    some = render(values, rows, view, trainable=20)
    assert some.active is not None
    lists, owners = full.lists, full.lists.gaussians < 20
    tiles = np.repeat(np.arange(view.tiles_x * view.tiles_y), np.diff(lists.starts))
    assert np.array_equal(np.flatnonzero(some.active), np.unique(tiles[owners]))
    drawn = with_neighbours(some.active)
    assert np.array_equal(np.sort(some.lists.order), np.flatnonzero(drawn))
    assert some.active.any()
    assert drawn.mean() < 0.5
    inside = drawn.repeat(TILE_PX, axis=0).repeat(TILE_PX, axis=1)
    assert np.array_equal(some.picture[:, inside], full.picture[:, inside])
    assert len(some.lists.pairs) < 0.8 * len(full.lists.pairs)


def test_where_nearly_all_matters_the_whole_picture_is_drawn() -> None:
    splats = scattered_splats(300, 8)
    values, view = Parameters(*splats.arrays), View.prepare(turned_camera(), NEAR_M)
    rendered = render(values, np.arange(300, dtype=np.int32), view, trainable=300)
    assert raster.NEARLY_ALL < 1
    assert rendered.active is None


def test_neighbours_are_the_eight_around() -> None:
    tiles = np.zeros((4, 6), np.bool_)
    tiles[0, 0] = tiles[2, 4] = True
    expected = np.zeros_like(tiles)
    expected[:2, :2] = expected[1:, 3:] = True
    assert np.array_equal(with_neighbours(tiles), expected)
    assert with_neighbours(np.ones((1, 1), np.bool_)).all()


@given(
    seed=st.integers(0, 10_000),
    height=st.integers(1, 80),
    width=st.integers(1, 130),
    reach=st.tuples(st.integers(0, 20), st.integers(0, 20)),
)
@settings(max_examples=60, deadline=None)
def test_runs_near_active_tiles(seed: int, height: int, width: int, reach: tuple[int, int]) -> None:
    rng = np.random.default_rng(seed)
    active = rng.random((-(-height // TILE_PX), -(-width // TILE_PX))) < 0.2
    reach_x, reach_y = reach
    expected = np.zeros((height, width), np.bool_)
    for y, x in np.argwhere(active) * TILE_PX:
        expected[
            max(y - reach_y, 0) : y + TILE_PX + reach_y, max(x - reach_x, 0) : x + TILE_PX + reach_x
        ] = True
    runs = Runs.around(active, reach_x, reach_y, height, width)
    got = np.zeros((height, width), np.int32)
    for y in range(height):
        for first, end in runs.bounds[runs.starts[y] : runs.starts[y + 1]]:
            assert 0 <= first < end <= width
            got[y, first:end] += 1
    assert np.array_equal(got, expected)  # each pixel once
    assert np.array_equal(runs.rows, np.flatnonzero(expected.any(axis=1)))
    assert runs.pixels == expected.sum()
