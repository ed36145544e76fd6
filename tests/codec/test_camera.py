"""Projection of a camera, and the same camera for other picture sizes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from codec.camera import Camera, Floating
from codec.pose import Doubles, look_at
from tests.support.drawn import posed_cameras

sides_px = st.integers(1, 2000)
shares = st.tuples(st.floats(-0.5, 1.5), st.floats(-0.5, 1.5), st.floats(0.1, 100))
"""Place of a point, in widths and heights of the picture, and its depth in metres."""


def point_at(camera: Camera, share: tuple[float, float, float]) -> Doubles:
    u, v, depth = (np.array(x) for x in share)
    return camera.unproject(u * camera.width_px, v * camera.height_px, depth)


def seen_at(camera: Camera, point: Doubles) -> tuple[float, float]:
    u_px, v_px, _ = camera.project(point)
    return float(u_px), float(v_px)


@given(posed_cameras())
def test_a_camera_sees_from_its_place_along_its_axes(camera: Camera) -> None:
    axes = np.stack([camera.right, camera.down, camera.forward])
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)
    ahead = camera.position + 2 * camera.forward
    u_px, v_px, depth = camera.project(ahead)
    assert float(depth) == pytest.approx(2)
    assert (float(u_px), float(v_px)) == pytest.approx((camera.cx_px, camera.cy_px), abs=1e-6)
    u_px, v_px, _ = camera.project(ahead + camera.right + camera.down)
    middle = (camera.cx_px + camera.fx_px / 2, camera.cy_px + camera.fy_px / 2)
    assert (float(u_px), float(v_px)) == pytest.approx(middle, rel=1e-6, abs=1e-6)


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


@given(posed_cameras(), st.floats(1e-4, 1))
def test_a_scaled_camera_is_resized_to_whole_pixels(camera: Camera, scale: float) -> None:
    small = camera.scaled(scale)
    sizes = (small.width_px, camera.width_px), (small.height_px, camera.height_px)
    for scaled_px, full_px in sizes:
        assert scaled_px >= 1
        assert scaled_px == 1 or abs(scaled_px - scale * full_px) <= 0.5 + 1e-9
    expected = camera.resized(small.width_px, small.height_px)
    assert small.to_json() == expected.to_json()
    assert camera.scaled(1).to_json() == camera.to_json()


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
def test_a_fitted_camera_loses_nothing(
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
