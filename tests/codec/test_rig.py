"""The point at which several cameras look, and their common up direction."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from codec.camera import Camera
from codec.pose import Doubles, look_at, rotation_about, world_to_camera
from codec.rig import closest_point, mean_up
from tests.support.drawn import directions, places, rotations
from tests.support.hosted_streams import ring_of_cameras


def camera_at(w2c: Doubles) -> Camera:
    return Camera("c", 64, 36, 50.0, 50.0, 32.0, 18.0, w2c)


def converging_pair(angle_rad: float) -> list[Camera]:
    """Two cameras whose axes meet ten metres ahead at this angle."""
    up = np.array([0.0, -1, 0])
    places_m = (np.zeros(3), np.array([20 * math.tan(angle_rad / 2), 0.0, 0.0]))
    target = places_m[1] / 2 + (0, 0, 10)
    return [camera_at(look_at(place, target, up)) for place in places_m]


@given(places, st.lists(directions, min_size=2, max_size=6), st.floats(0.5, 50))
def test_axes_that_meet(target: Doubles, ways: list[Doubles], distance_m: float) -> None:
    sines = [np.linalg.norm(np.cross(ways[0], way)) for way in ways[1:]]
    assume(max(sines) > 0.2)
    up = np.array([0.3, -0.9, 0.31])
    assume(all(np.linalg.norm(np.cross(way, up)) > 0.01 for way in ways))
    cameras = [camera_at(look_at(target - distance_m * way, target, up)) for way in ways]
    found = closest_point(cameras, 1e-6)
    assert found is not None
    np.testing.assert_allclose(found, target, atol=1e-6)
    # If all cameras look the other way, the point is behind them.
    turned = [replace(c, w2c=np.diag([1.0, -1, -1, 1]) @ c.w2c) for c in cameras]
    assert closest_point(turned, 1e-6) is None


def test_a_ring_of_cameras_looks_at_its_middle() -> None:
    found = closest_point(ring_of_cameras(5), 1e-3)
    assert found is not None
    np.testing.assert_allclose(found, [0, 0, 4], atol=1e-9)


def test_the_closest_point_of_axes_that_pass_each_other_is_half_way_between() -> None:
    along_z = camera_at(np.eye(4))
    turn = rotation_about(np.array([0.0, 1, 0]), math.pi / 2)
    along_x = camera_at(world_to_camera(turn.T, np.array([-3.0, 0.5, 4])))
    np.testing.assert_allclose(along_x.forward, [1, 0, 0], atol=1e-12)
    found = closest_point([along_z, along_x], 1e-6)
    np.testing.assert_allclose(found, [0, 0.25, 4], atol=1e-9)  # type: ignore[arg-type]


@given(rotations)
def test_parallel_axes_have_no_closest_point(rotation: Doubles) -> None:
    cameras = [
        camera_at(world_to_camera(rotation, np.array(place, np.float64)))
        for place in ((0, 0, 0), (1, 0, 0), (0, 2, 1))
    ]
    assert closest_point(cameras, 1e-6) is None
    assert closest_point(cameras[:1], 1e-6) is None
    assert closest_point([], 1e-6) is None


@pytest.mark.parametrize("angle_deg", [1.0, 5.0, 40.0])
def test_the_least_spread_is_the_mean_squared_sine_between_the_axes(angle_deg: float) -> None:
    cameras = converging_pair(math.radians(angle_deg))
    # Each axis is half of the angle away from the direction between the two.
    spread = math.sin(math.radians(angle_deg) / 2) ** 2
    assert closest_point(cameras, 1.001 * spread) is None
    found = closest_point(cameras, 0.999 * spread)
    assert found is not None
    assert found[2] == pytest.approx(10)


def test_up_is_where_the_tops_of_the_pictures_point() -> None:
    np.testing.assert_allclose(mean_up(ring_of_cameras()), [0, -1, 0], atol=1e-9)


@given(st.lists(rotations, min_size=1, max_size=6))
def test_up_is_a_unit_vector_and_the_sum_of_the_tops(turns: list[Doubles]) -> None:
    cameras = [camera_at(world_to_camera(turn, np.zeros(3))) for turn in turns]
    up = mean_up(cameras)
    assert np.linalg.norm(up) == pytest.approx(1)
    total = -np.sum([camera.down for camera in cameras], axis=0)
    if np.linalg.norm(total) > 1e-2 * len(cameras):
        np.testing.assert_allclose(np.cross(up, total), np.zeros(3), atol=1e-9)
        assert up @ total > 0


def test_where_tops_cancel_out_the_first_camera_tells_what_is_up() -> None:
    upright, overhead = camera_at(np.eye(4)), camera_at(np.diag([-1.0, -1, 1, 1]))
    np.testing.assert_allclose(mean_up([upright, overhead]), [0, -1, 0])
    np.testing.assert_allclose(mean_up([overhead, upright]), [0, 1, 0])
