"""Cameras, poses and rigs, and Gaussians moved as one body."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from codec.arrays import Doubles
from codec.camera import (
    Camera,
    Floating,
    look_at,
    quat_of,
    rotation_about,
    rotation_of,
    slerp,
    world_to_camera,
)
from codec.errors import InvalidError
from codec.rig import closest_point, rig_up
from codec.similarity import Similarity, harmonics, turned_harmonics
from codec.splats import SH_C0, Splats
from tests.support.alike import shapes
from tests.support.drawn import directions, places, posed_cameras, rotations, turns_rad
from tests.support.hostile import refused
from tests.support.trained_like import trained_like_splats

sides_px = st.integers(1, 2000)
shares = st.tuples(st.floats(-0.5, 1.5), st.floats(-0.5, 1.5), st.floats(0.1, 100))
"""Place of a point, in widths and heights of the picture, and its depth in metres."""


def point_at(camera: Camera, share: tuple[float, float, float]) -> Doubles:
    u, v, depth = (np.array(x) for x in share)
    return camera.unproject(u * camera.width_px, v * camera.height_px, depth)


def seen_at(camera: Camera, point: Doubles) -> tuple[float, float]:
    u_px, v_px, _ = camera.project(point)
    return float(u_px), float(v_px)


def test_pixels_of_a_camera_that_can_be_read_off() -> None:
    pose = look_at(np.array([0.0, 0, -2]), np.zeros(3), np.array([0.0, -1, 0]))
    camera = Camera("c", 640, 480, 100.0, 200.0, 320.0, 240.0, pose)
    u_px, v_px, depths = camera.project(np.array([[1.0, 0.5, 0], [0, -1, 2]]))
    np.testing.assert_allclose(u_px, [370, 320])
    np.testing.assert_allclose(v_px, [290, 190])
    np.testing.assert_allclose(depths, [2, 4])


@given(posed_cameras(), st.lists(shares, min_size=1, max_size=5))
def test_pixels_come_back(camera: Camera, share: list[tuple[float, float, float]]) -> None:
    u_px, v_px, depths = np.array(share).T
    u_px, v_px = u_px * camera.width_px, v_px * camera.height_px
    points = camera.unproject(u_px, v_px, depths)
    assert points.shape == (len(share), 3)
    for found, expected in zip(camera.project(points), (u_px, v_px, depths), strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-6)
    again = camera.unproject(*camera.project(points))
    np.testing.assert_allclose(again, points, rtol=1e-6, atol=1e-6)
    x, y, w = camera.intrinsics @ (camera.w2c[:3, :3] @ points.T + camera.w2c[:3, 3:])
    np.testing.assert_allclose((x / w, y / w), (u_px, v_px), rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_points_beside_and_behind_a_camera_have_no_depth_above_zero(dtype: type) -> None:
    camera = Camera("c", 64, 36, 50.0, 50.0, 32.0, 18.0, np.eye(4))
    points: Floating = np.array([[0, 0, 0], [1, 0, 0], [0, 0, -1], [0, 0, 1]], dtype)
    u_px, v_px, depths = camera.project(points)  # no warning of a division by zero
    assert (depths > 0).tolist() == [False, False, False, True]
    assert {found.dtype for found in (u_px, v_px, depths)} == {np.dtype(dtype)}
    assert (u_px[3], v_px[3]) == (32, 18)


@given(posed_cameras(), sides_px, sides_px, shares)
def test_a_resized_camera_shows_the_same_view(
    camera: Camera, width_px: int, height_px: int, share: tuple[float, float, float]
) -> None:
    other = camera.resized(width_px, height_px)
    u_px, v_px = seen_at(other, point_at(camera, share))
    assert (other.width_px, other.height_px) == (width_px, height_px)
    expected = (share[0] * width_px, share[1] * height_px)
    assert (u_px, v_px) == pytest.approx(expected, rel=1e-6, abs=1e-6)


@given(posed_cameras(), shares)
def test_a_halved_camera(camera: Camera, share: tuple[float, float, float]) -> None:
    full = camera.resized(max(2, camera.width_px), max(2, camera.height_px))
    half = full.halved()
    point = point_at(full, share)
    expected = tuple(px / 2 for px in seen_at(full, point))
    assert seen_at(half, point) == pytest.approx(expected, rel=1e-9, abs=1e-6)
    assert (half.width_px, half.height_px) == (full.width_px // 2, full.height_px // 2)
    if full.width_px % 2 == full.height_px % 2 == 0:
        assert half.to_json() == full.resized(half.width_px, half.height_px).to_json()


@given(posed_cameras(), sides_px, sides_px, st.integers(1, 4))
def test_a_fitted_camera_is_whole(
    camera: Camera, width_px: int, height_px: int, times: int
) -> None:
    other = camera.fitted(width_px, height_px)
    assert (other.width_px, other.height_px) == (width_px, height_px)
    assert other.fx_px / other.fy_px == pytest.approx(camera.fx_px / camera.fy_px)
    assert other.width_px / other.fx_px >= camera.width_px / camera.fx_px * (1 - 1e-9)
    assert other.height_px / other.fy_px >= camera.height_px / camera.fy_px * (1 - 1e-9)
    # The middle stays the middle, and points in the picture stay in it.
    middle = seen_at(other, point_at(camera, (0.5, 0.5, 1)))
    assert middle == pytest.approx((width_px / 2, height_px / 2), rel=1e-6, abs=1e-6)
    for corner in ((0, 0, 1), (1, 1, 1)):
        u_px, v_px = seen_at(other, point_at(camera, corner))
        assert -1e-3 <= u_px <= width_px + 1e-3
        assert -1e-3 <= v_px <= height_px + 1e-3
    # In the same shape it is resized.
    size = camera.width_px * times, camera.height_px * times
    for key, value in camera.resized(*size).to_json().items():
        assert camera.fitted(*size).to_json()[key] == pytest.approx(value)


@given(directions, turns_rad)
def test_quaternions_and_rotations_are_the_same(axis: Doubles, angle_rad: float) -> None:
    rotation = rotation_about(axis, angle_rad)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1)
    np.testing.assert_allclose(rotation_of(quat_of(rotation)), rotation, atol=1e-9)
    quat = np.array([math.cos(angle_rad / 2), *(math.sin(angle_rad / 2) * axis)])
    np.testing.assert_allclose(rotation_of(quat), rotation, atol=1e-12)
    quarter = rotation_about(np.array([0.0, 0, 1]), math.pi / 2)
    np.testing.assert_allclose(quarter @ [1, 0, 0], [0, 1, 0], atol=1e-12)


@given(directions, st.floats(-3, 3), st.floats(0, 1))
def test_slerp_turns_evenly(axis: Doubles, angle_rad: float, share: float) -> None:
    first, last = np.eye(3), rotation_about(axis, angle_rad)
    between = rotation_of(slerp(quat_of(first), quat_of(last), share))
    np.testing.assert_allclose(between, rotation_about(axis, share * angle_rad), atol=1e-6)


@given(rotations, places)
def test_a_pose_takes_its_place_to_0(rotation: Doubles, position: Doubles) -> None:
    w2c = world_to_camera(rotation, position)
    np.testing.assert_allclose(w2c @ [*position, 1], [0, 0, 0, 1], atol=1e-12)
    for axis, expected in zip(rotation, np.eye(3), strict=True):
        np.testing.assert_allclose(w2c[:3, :3] @ axis, expected, atol=1e-12)


def test_what_cannot_be_looked_at_is_refused() -> None:
    refused(InvalidError, "", look_at, np.zeros(3), np.array([0.0, 1, 0]), np.array([0.0, -1, 0]))
    refused(InvalidError, "", look_at, np.ones(3), np.ones(3), np.array([0.0, -1, 0]))


@given(places, directions, st.floats(0.01, 100), directions, st.floats(1e-3, 1e3))
def test_look_at_puts_the_target_on_the_axis_and_up_upwards(
    position: Doubles, direction: Doubles, distance_m: float, up: Doubles, length: float
) -> None:
    assume(np.linalg.norm(np.cross(direction, up)) > 1e-3)
    w2c = look_at(position, position + distance_m * direction, length * up)
    np.testing.assert_allclose(w2c[:3, :3] @ w2c[:3, :3].T, np.eye(3), atol=1e-12)
    assert np.linalg.det(w2c) == pytest.approx(1)
    np.testing.assert_allclose(w2c[:3, :3] @ position + w2c[:3, 3], np.zeros(3), atol=1e-10)
    target = w2c[:3, :3] @ (position + distance_m * direction) + w2c[:3, 3]
    np.testing.assert_allclose(target, [0, 0, distance_m], atol=1e-8)
    right, down, _ = w2c[:3, :3] @ up
    assert right == pytest.approx(0, abs=1e-8)
    assert down < 0


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


def held(yaw_deg: float, pitch_deg: float, roll_deg: float) -> Camera:
    """A camera of a rig in which y points down."""
    yaw, pitch, roll = map(math.radians, (yaw_deg, pitch_deg, roll_deg))
    turn = rotation_about(np.array([0.0, 1, 0]), yaw)
    turn = turn @ rotation_about(np.array([1.0, 0, 0]), pitch)
    turn = turn @ rotation_about(np.array([0.0, 0, 1]), roll)
    return camera_at(world_to_camera(turn.T, np.zeros(3)))


@given(rotations, st.lists(st.floats(-60, 60), min_size=3, max_size=8))
def test_a_rig_on_one_side_that_looks_down_knows_what_is_up(
    turn: Doubles, pitches_deg: list[float]
) -> None:
    yaws_deg = np.linspace(-90, 90, len(pitches_deg))
    rig = [held(yaw, pitch, 0) for yaw, pitch in zip(yaws_deg, pitches_deg, strict=True)]
    turned = [replace(one, w2c=one.w2c @ affine(turn.T, np.zeros(3))) for one in rig]
    if -sum(one.down[1] for one in rig) / len(rig) > 0.9:  # else their tops say nothing of the sign
        np.testing.assert_allclose(rig_up(turned), turn @ [0, -1, 0], atol=1e-9)


@pytest.mark.parametrize(
    ("held_deg", "up"),
    # player/web/test/camera.test.mjs has the same
    [
        ([(0, -20, 1), (30, -25, -2), (65, -10, 0), (90, -30, 1)], (-0.0069, -1, -0.0026)),
        ([(0, -20, 0), (1, -20, 0)], (0.0030, -0.9397, 0.3420)),  # they look one way
        ([(0, 0, 90), (90, 0, 90), (180, 0, 90)], (0, 0, -1)),  # on their side,
    ],
)
def test_up_of_rigs(
    held_deg: list[tuple[float, float, float]], up: tuple[float, float, float]
) -> None:
    np.testing.assert_allclose(rig_up([held(*one) for one in held_deg]), up, atol=1e-4)


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
    refused(InvalidError, says, Similarity.of, matrix)


def test_what_leaves_the_range_of_floats_is_refused() -> None:
    far = Similarity.of(np.diag([1e38, 1e38, 1e38, 1.0]))
    refused(InvalidError, "not finite", far.moved, trained_like_splats(2000))
    turn = Similarity.of(affine(rotation_about(np.array([0.6, 0, 0.8]), 1), np.zeros(3)))
    huge = np.full((1, 4), np.finfo(np.float32).max)
    small = trained_like_splats(1)
    long = Splats(small.means, small.log_scales, huge, small.logit_opacities, small.sh)
    refused(InvalidError, "quats holds a value that is not finite", turn.moved, long)


def test_where_tops_cancel_out_the_first_camera_tells_what_is_up() -> None:
    upright, overhead = camera_at(np.eye(4)), camera_at(np.diag([-1.0, -1, 1, 1]))
    np.testing.assert_allclose(rig_up([upright, overhead]), [0, -1, 0])
    np.testing.assert_allclose(rig_up([overhead, upright]), [0, 1, 0])
