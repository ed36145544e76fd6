"""The eyes as cameras: side by side, and in the form of a headset."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from codec.camera import Camera
from codec.pose import look_at, rotation_about
from tests.support.web.browsercamera import for_browser, from_browser
from tests.support.web.browsercode import BrowserCode

Doubles = npt.NDArray[np.float64]

EYE_DISTANCE_M = 0.07
FOCUS_M = 3.0
XR_UP = np.array([0.0, 1.0, 0.0])


def some_direction(rng: np.random.Generator) -> Doubles:
    vector = rng.normal(size=3)
    direction: Doubles = vector / np.linalg.norm(vector)
    return direction


def some_camera(rng: np.random.Generator) -> Camera:
    pose = look_at(rng.normal(size=3), rng.normal(size=3) + 9, some_direction(rng))
    return Camera("c", 320, 240, 300.0, 310.0, 170.0, 111.0, pose)


@pytest.mark.parametrize("seed", range(4))
def test_eyes_side_by_side(browser: BrowserCode, seed: int) -> None:
    rng = np.random.default_rng(seed)
    camera = some_camera(rng)
    found = browser.ask(
        "eyes", camera=for_browser(camera), eyeDistanceM=EYE_DISTANCE_M, focusM=FOCUS_M
    )
    left, right = (from_browser(view["camera"]) for view in found["views"])
    assert [view["corner"] for view in found["views"]] == [
        {"xPx": 0, "yPx": 0},
        {"xPx": 320, "yPx": 0},
    ]
    np.testing.assert_allclose(right.position - left.position, EYE_DISTANCE_M * camera.right)
    np.testing.assert_allclose((left.position + right.position) / 2, camera.position)
    np.testing.assert_allclose(np.reshape(found["middle"], (4, 4)), camera.w2c, atol=1e-12)

    u_px, v_px = rng.uniform(0, 320, 50), rng.uniform(0, 240, 50)
    depths_m = rng.uniform(1, 20, 50)
    depths_m[0] = FOCUS_M
    points = camera.unproject(u_px, v_px, depths_m)
    left_px, right_px = left.project(points), right.project(points)
    for seen in (left_px, right_px):  # so that one order, and one row, serves both
        np.testing.assert_allclose(seen[2], depths_m)
        np.testing.assert_allclose(seen[1], v_px)
    disparity_px = 300 * EYE_DISTANCE_M * (1 / depths_m - 1 / FOCUS_M)
    np.testing.assert_allclose(left_px[0] - right_px[0], disparity_px, atol=1e-9)
    np.testing.assert_allclose((left_px[0] + right_px[0]) / 2, u_px)


def some_transform(rng: np.random.Generator) -> Doubles:
    """(4, 4) from the space of a view to the space of a headset."""
    transform = np.eye(4)
    transform[:3, :3] = rotation_about(some_direction(rng), rng.uniform(0, np.pi))
    transform[:3, 3] = rng.normal(size=3)
    return transform


def frustum(left: float, right: float, bottom: float, top: float) -> Doubles:
    """(4, 4) projection of OpenGL from the tangents of the angles to the sides."""
    near, far = 0.1, 1000.0
    return np.array(
        [
            [2 / (right - left), 0, (right + left) / (right - left), 0],
            [0, 2 / (top - bottom), (top + bottom) / (top - bottom), 0],
            [0, 0, (near + far) / (near - far), 2 * near * far / (near - far)],
            [0, 0, -1, 0],
        ]
    )


def columns(matrix: Doubles) -> list[float]:
    """The matrix in the column order of WebXR."""
    return matrix.ravel(order="F").tolist()


def placed(
    browser: BrowserCode, head: Doubles, start: Camera, up: Doubles, transform: Doubles
) -> Camera:
    return from_browser(
        browser.ask(
            "eye",
            head=columns(head),
            start=start.w2c.ravel().tolist(),
            up=up.tolist(),
            transform=columns(transform),
            projection=columns(frustum(-1, 1, -1, 1)),
            widthPx=100,
            heightPx=100,
        )
    )


@pytest.mark.parametrize("seed", range(4))
def test_an_eye_of_a_headset_projects_as_opengl_does(browser: BrowserCode, seed: int) -> None:
    """Here the headset's space is the world, except for the names of the axes."""
    rng = np.random.default_rng(seed)
    projection = frustum(*rng.uniform((-2, 0.2, -2, 0.2), (-0.2, 2, -0.2, 2)))
    transform = some_transform(rng)
    camera = from_browser(
        browser.ask(
            "eye",
            head=columns(np.eye(4)),
            start=np.diag([1.0, -1.0, -1.0, 1.0]).ravel().tolist(),
            up=XR_UP.tolist(),
            transform=columns(transform),
            projection=columns(projection),
            widthPx=1680,
            heightPx=1760,
        )
    )
    local = rng.uniform((-3, -3, -9, 1), (3, 3, -1, 1), (50, 4))
    local[:, 3] = 1
    clip = local @ projection.T
    u_px = (1 + clip[:, 0] / clip[:, 3]) / 2 * 1680
    v_px = (1 - clip[:, 1] / clip[:, 3]) / 2 * 1760
    seen = camera.project((local @ transform.T)[:, :3])
    np.testing.assert_allclose(seen, (u_px, v_px, -local[:, 2]))


def yawed(rng: np.random.Generator) -> Doubles:
    """(4, 4) a headset's space that starts elsewhere: moved, and turned about the vertical."""
    change = np.eye(4)
    change[:3, :3] = rotation_about(XR_UP, rng.uniform(-np.pi, np.pi))
    change[:3, 3] = rng.normal(size=3)
    return change


@pytest.mark.parametrize("tilt_rad", [-np.pi / 2, -1.0, 0.0, 0.7, np.pi / 2])
@pytest.mark.parametrize("start_tilt_rad", [-np.pi / 2, 0.4, np.pi / 2])
def test_the_viewer_begins_at_the_start(
    browser: BrowserCode, tilt_rad: float, start_tilt_rad: float
) -> None:
    """Both faced the same way before they tilted their heads."""
    rng = np.random.default_rng(7)
    up = some_direction(rng)
    place = rng.normal(size=3)
    level = Camera(
        "c", 100, 100, 50, 50, 50, 50, look_at(place, place + np.cross(up, rng.normal(size=3)), up)
    )
    tilt = np.eye(4)
    tilt[:3, :3] = rotation_about(np.array([1.0, 0, 0]), -start_tilt_rad)
    start = from_browser({**for_browser(level), "w2c": tilt @ level.w2c})
    level_head = yawed(rng)
    head = level_head.copy()
    head[:3, :3] = head[:3, :3] @ rotation_about(np.array([1.0, 0, 0]), tilt_rad)
    np.testing.assert_allclose(
        placed(browser, head, start, up, level_head).w2c, level.w2c, atol=1e-9
    )
    np.testing.assert_allclose(
        placed(browser, head, start, up, head).position, start.position, atol=1e-9
    )


def test_where_a_headset_counts_from_changes_nothing(browser: BrowserCode) -> None:
    rng = np.random.default_rng(3)
    start, up = some_camera(rng), some_direction(rng)
    head, eye, change = some_transform(rng), some_transform(rng), yawed(rng)
    found = placed(browser, head, start, up, eye)
    again = placed(browser, change @ head, start, up, change @ eye)
    np.testing.assert_allclose(again.w2c, found.w2c, atol=1e-9)
    # A metre is a metre.
    moved_m = np.linalg.norm(eye[:3, 3] - head[:3, 3])
    assert np.linalg.norm(found.position - start.position) == pytest.approx(moved_m)


def test_the_middle_of_eyes_that_look_outwards(browser: BrowserCode) -> None:
    middle = some_camera(np.random.default_rng(1))
    w2cs = []
    for side in (-1, 1):
        outward = np.eye(4)
        outward[:3, :3] = rotation_about(np.array([0.0, 1.0, 0.0]), -side * 0.09)
        outward[0, 3] = -side * 0.03
        w2cs.append((outward @ middle.w2c).ravel().tolist())
    found = np.reshape(browser.ask("middle", w2cs=w2cs), (4, 4))
    np.testing.assert_allclose(found[:3, :3], middle.w2c[:3, :3], atol=1e-12)
    # Turned first, then moved along the turned axis: the middle is on the axis.
    offset = middle.w2c @ np.append(np.linalg.inv(found)[:3, 3], 1)
    np.testing.assert_allclose(offset[:2], 0, atol=1e-12)
