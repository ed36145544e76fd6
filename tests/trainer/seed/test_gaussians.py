"""Seeds are where cameras agree; spacing of first Gaussians; depth of the nearest objects."""

from __future__ import annotations

import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from codec.arrays import Floats
from codec.camera import Camera
from codec.splats import SH_C0
from tests.support.tiny_capture import tiny_rig
from trainer.seed.gaussians import (
    MIN_IN_VIEW,
    MIN_STRAYS,
    SPACING_SCALE,
    initial_splats,
    nearest_seen,
    share_nearer,
    spacings,
    stereo_seeds,
)
from trainer.seed.stereo import better_half

FLOOR_Y_M = 0.0


def colour_at(x: np.ndarray, z: np.ndarray) -> np.ndarray:
    """A smooth pattern on the floor that does not repeat nearby."""
    waves = [np.sin(2.1 * x + 0.7 * z), np.sin(1.3 * z - 0.9 * x + 1), np.sin(0.8 * x * z + 2)]
    return 0.5 + 0.5 * np.stack(waves, axis=-1)


def rays_of(camera: Camera, v: np.ndarray, u: np.ndarray) -> np.ndarray:
    """(..., 3) viewing rays through places of the picture in the world, one metre deep."""
    local = [(u - camera.cx_px) / camera.fx_px, (v - camera.cy_px) / camera.fy_px, 0 * u + 1]
    rays: np.ndarray = np.stack(local, axis=-1) @ camera.w2c[:3, :3]
    return rays


def picture_of_floor(camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """(H, W, 3) uint8 picture, and (H, W) bool: pixels that see the floor within five metres."""
    rays = rays_of(camera, *np.mgrid[0 : camera.height_px, 0 : camera.width_px] + 0.5)
    with np.errstate(divide="ignore"):
        depth = (FLOOR_Y_M - camera.position[1]) / rays[..., 1]
    hit = camera.position + depth[..., None] * rays
    seen = (depth > 0) & (np.hypot(hit[..., 0], hit[..., 2]) < 5)
    picture = np.where(seen[..., None], colour_at(hit[..., 0], hit[..., 2]), 0.0)
    return np.rint(picture * 255).astype(np.uint8), seen


def test_seeds_of_a_painted_floor_lie_on_it_for_cameras_of_any_sizes() -> None:
    sizes = [(128, 72), (96, 54), (320, 180)]
    cameras = [c.resized(*sizes[i % 3]) for i, c in enumerate(tiny_rig(8))]
    pictures, seen = zip(*map(picture_of_floor, cameras), strict=True)
    assert np.mean(seen[0]) > 0.3
    points, colours = stereo_seeds(cameras, pictures, 3000, 0.8, 9.0, np.random.default_rng(0))
    assert len(points) == len(colours) == 3000
    coloured = colours.max(axis=1) > 0  # the rest look over the floor into the dark
    on_floor = np.abs(points[coloured, 1] - FLOOR_Y_M) < 0.2
    assert coloured.sum() > 500
    assert on_floor.mean() > 0.8
    x, z = points[coloured][on_floor][:, 0], points[coloured][on_floor][:, 2]
    assert np.median(np.abs(colour_at(x, z) * 255 - colours[coloured][on_floor])) < 12


def test_no_seed_lies_behind_an_ignored_pixel_nor_depends_on_what_it_shows() -> None:
    """Although the colours of the cameras differ."""
    cameras = [c.resized(128, 72) for c in tiny_rig(8)]
    pictures, seen = zip(*map(picture_of_floor, cameras), strict=True)
    masks = [floor.astype(np.uint8) for floor in seen]
    masks[3][:] = 0

    def seeds(garbage: int) -> np.ndarray:
        shown = [
            np.where(mask[:, :, None] > 0, np.clip(p * (0.9 + 0.03 * i) + 2 * i, 0, 255), garbage)
            for i, (p, mask) in enumerate(zip(pictures, masks, strict=True))
        ]
        shown = [picture.astype(np.uint8) for picture in shown]
        rng = np.random.default_rng(0)
        points, colours = stereo_seeds(cameras, shown, 1000, 0.8, 9.0, rng, masks)
        assert len(points) == 1000
        assert (colours.max(axis=1) > 0).all()
        return points

    points = seeds(0)
    np.testing.assert_array_equal(points, seeds(200))
    assert np.mean(np.abs(points[:, 1] - FLOOR_Y_M) < 0.2) > 0.8


def test_cameras_back_to_back_or_where_all_is_ignored_give_no_seed() -> None:
    around, rng = np.diag([1.0, -1.0, -1.0, 1.0]), np.random.default_rng(0)
    away = [
        Camera(f"{i}", 64, 36, 60.0, 60.0, 32.0, 18.0, w2c)
        for i, w2c in enumerate((np.eye(4), around))
    ]
    black = [np.zeros((36, 64, 3), np.uint8)] * 2
    assert len(stereo_seeds(away, black, 50, 0.5, 5.0, rng)[0]) == 0
    cameras = [c.resized(128, 72) for c in tiny_rig(4)]
    pictures, masks = [picture_of_floor(c)[0] for c in cameras], [np.zeros((72, 128), np.uint8)] * 4
    assert len(stereo_seeds(cameras, pictures, 50, 0.8, 9.0, rng, masks)[0]) == 0


def test_first_gaussians_are_round_coloured_and_as_large_as_their_spacing() -> None:
    grid = np.stack(np.meshgrid(*[np.arange(5) * 0.1] * 3), -1).reshape(-1, 3).astype(np.float32)
    colours = np.full((125, 3), 200, np.uint8)
    splats = initial_splats(grid, colours, 1)
    assert splats.sh_degree == 1
    np.testing.assert_allclose(np.exp(splats.log_scales), 0.1 * SPACING_SCALE, rtol=1e-4)
    np.testing.assert_allclose(0.5 + SH_C0 * splats.sh[:, 0], 200 / 255, rtol=1e-5)
    assert (splats.sh[:, 1:] == 0).all()
    for count in (1, 2, 50):  # points that coincide
        splats = initial_splats(np.zeros((count, 3), np.float32), colours[:count], 0)
        assert len(splats) == count
        assert np.isfinite(splats.log_scales).all()


def spacings_by_all_pairs(points: Floats) -> Floats:
    """The definition of `spacings`, every step in float32."""
    dx, dy, dz = (points[:, None] - points[None]).transpose(2, 0, 1)
    squares = dx * dx + dy * dy + dz * dz
    np.fill_diagonal(squares, np.inf)
    a, b, c = np.sort(squares, axis=1)[:, :3].T
    result: Floats = np.sqrt((a + b + c) / np.float32(3))
    return result


def coordinates(limit: float) -> st.SearchStrategy[float]:
    """Coordinates of points in metres, not so near 0 that their squares are 0 in float32."""
    return st.floats(-limit, limit, width=32).filter(lambda x: x == 0 or abs(x) > 1e-9)


@settings(max_examples=25)
@given(
    # Ties and duplicates; near and far places; places that float32 can hardly distinguish.
    st.sampled_from(
        [st.integers(0, 2), coordinates(10), coordinates(1e9), st.integers(2**24 - 16, 2**24)]
    )
    .flatmap(lambda coordinate: npst.arrays(np.float32, (12, 3), elements=coordinate))
    .flatmap(lambda places: st.lists(st.sampled_from(list(places)), min_size=4, max_size=60))
)
def test_spacings_are_those_of_comparing_all_pairs(points: list[Floats]) -> None:
    array = np.stack(points)
    np.testing.assert_array_equal(spacings(array), spacings_by_all_pairs(array))


def test_spacings_are_exact_where_many_places_are_almost_equally_near() -> None:
    """Float32 orders the places of a sphere around a point differently than float64 does."""
    rng = np.random.default_rng(0)
    for _ in range(10):
        sphere = rng.normal(size=(500, 3))
        sphere /= np.linalg.norm(sphere, axis=1, keepdims=True)
        places = np.concatenate([np.zeros((1, 3)), sphere]) + rng.normal(size=3)
        points: Floats = places.astype(np.float32)
        np.testing.assert_array_equal(spacings(points), spacings_by_all_pairs(points))


@pytest.mark.realtime
def test_spacings_of_many_points_take_seconds() -> None:
    for places in (1, 100_000, 200_000):
        points = np.random.default_rng(0).normal(size=(places, 3)).astype(np.float32)
        points = np.concatenate([points, np.repeat(points[:1], 200_000 - places, axis=0)])
        begun_s = time.process_time()
        assert (spacings(points) == 0).sum() == (0 if places == 200_000 else 200_001 - places)
        # It takes one second; comparing all pairs takes a minute.
        assert time.process_time() - begun_s < 15


def camera(forward: float = 1.0) -> Camera:
    """A camera at the origin that looks along z, or in the opposite direction."""
    pose = np.diag([1.0, forward, forward, 1.0])
    return Camera("c", 64, 64, 32.0, 32.0, 32.0, 32.0, pose)


def places(depths: np.ndarray) -> np.ndarray:
    """Places on the axis of the camera."""
    return np.stack([0 * depths, 0 * depths, depths], axis=1)


def test_a_few_strays_do_not_count() -> None:
    depths = np.linspace(2.0, 9.0, 200)
    assert nearest_seen([camera()], places(depths)) == pytest.approx(depths[MIN_STRAYS])
    strayed = np.concatenate([np.full(MIN_STRAYS, 0.1), depths])
    assert nearest_seen([camera()], places(strayed)) == pytest.approx(2.0)
    assert nearest_seen([camera()], places(np.append(strayed, 0.2))) == pytest.approx(0.2)
    many = np.concatenate([np.full(50, 0.1), np.linspace(2.0, 9.0, 10_000)])
    assert nearest_seen([camera()], places(many)) == pytest.approx(2.0, rel=0.01)


def test_what_is_out_of_view_does_not_count() -> None:
    behind = places(np.linspace(0.5, 3.0, 500))
    assert nearest_seen([camera(-1.0)], behind) is None
    beside = behind + (1.1, 0.0, 0.0) * behind[:, 2:]
    assert nearest_seen([camera()], beside) is None
    assert nearest_seen([camera(-1.0), camera()], behind) == pytest.approx(0.5, rel=0.1)


def test_too_few_places_tell_nothing() -> None:
    few = places(np.linspace(1.0, 2.0, MIN_IN_VIEW - 1))
    assert nearest_seen([camera()], few) is None
    assert nearest_seen([], few) is None
    assert share_nearer(camera(), few, 1.5) == 0
    enough = places(np.linspace(1.0, 2.0, 101))
    assert share_nearer(camera(), enough, 1.5) == pytest.approx(50 / 101)


@given(st.lists(st.integers(0, 255), min_size=2, max_size=9), st.integers(1, 2))
def test_the_better_half_is_the_lower_one_whatever_the_order(costs: list[int], least: int) -> None:
    spare = np.array([*costs, 0, 0], np.float32)  # values after the costs do not count
    lower = sorted(costs)[: max(least, (len(costs) + 1) // 2)]
    assert better_half(spare, len(costs), least) == pytest.approx(np.mean(lower), rel=1e-6)
    # Of two cameras one settles a depth unless two are asked for.
    two = np.array([5.0, 1.0], np.float32)
    assert (better_half(two, 2, 1), better_half(two, 2, 2)) == (1, 3)
