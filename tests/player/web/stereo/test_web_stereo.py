"""The page for two eyes: side by side, and on an emulated headset."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from codec.arrays import Doubles
from codec.camera import Camera, rotation_about, world_to_camera
from tests.support.web.canvas import (
    LEAST_PSNR_DB,
    camera_of,
    canvas_of,
    check_picture,
    expected_of,
    picture_of,
    psnr_db,
)
from tests.support.web.chromium import Page
from tests.support.web.nodeprocess import PACKAGES, SCRIPTS, Json
from tests.support.web.site import Site

EMULATOR = PACKAGES / "iwer" / "build" / "iwer.min.js"
HEADSET = SCRIPTS / "headset.js"
EMULATED_EYES_M = 1.6
SIZE_PX = WIDTH_PX, HEIGHT_PX = 640, 320
IN_HEADSET = "player.headset?.last"


@pytest.fixture
def worn(page: Page, site: Site) -> Page:
    """The page with a headset."""
    if not EMULATOR.is_file():
        pytest.skip("needs the emulator of headsets: scripts/setup dev")
    site.watch(page, "whole", scripts=(EMULATOR, HEADSET), size_px=SIZE_PX)
    return page


def aside(camera: Camera, aside_m: float) -> Camera:
    """The same camera, moved to its right."""
    return replace(
        camera, w2c=world_to_camera(camera.w2c[:3, :3], camera.position + aside_m * camera.right)
    )


def test_side_by_side(page: Page, site: Site) -> None:
    site.watch(page, "whole", size_px=SIZE_PX)
    check_picture(page, site.reader("whole"))
    alone = canvas_of(page)
    page.press("e")
    both = canvas_of(page)
    half = camera_of(page.value("player.camera"))
    page.press("e")
    np.testing.assert_array_equal(canvas_of(page), alone)
    assert (half.width_px, half.height_px) == (WIDTH_PX // 2, HEIGHT_PX)
    # The scene's centre is 4 m away, and shows at the same place to both eyes.
    pictures = {}
    for side, picture in zip((-0.5, 0.5), np.split(both, 2, axis=1), strict=True):
        eye = aside(half, side * 0.063)
        eye = replace(eye, cx_px=half.cx_px + half.fx_px * side * 0.063 / 4)
        pictures[side] = expected_of(site.reader("whole"), eye)
        assert psnr_db(picture, pictures[side]) >= LEAST_PSNR_DB
    assert psnr_db(pictures[-0.5], pictures[0.5]) < LEAST_PSNR_DB - 10


def head_pose(place: tuple[float, float, float], yaw_rad: float, pitch_rad: float) -> Doubles:
    """(4, 4) pose of a turned head, in the space of a session, whose origin is at the eyes' height
    at its start: axes right, up and back."""
    pose = np.eye(4)
    yaw = rotation_about(np.array([0.0, 1.0, 0.0]), yaw_rad)
    pose[:3, :3] = yaw @ rotation_about(np.array([1.0, 0.0, 0.0]), pitch_rad)
    pose[:3, 3] = place - np.array([0.0, EMULATED_EYES_M, 0.0])
    return pose


def turn_head(
    page: Page, place: tuple[float, float, float], yaw_rad: float, pitch_rad: float
) -> None:
    cy, sy = np.cos(yaw_rad / 2), np.sin(yaw_rad / 2)
    cp, sp = np.cos(pitch_rad / 2), np.sin(pitch_rad / 2)
    quaternion = [cy * sp, sy * cp, -sy * sp, cy * cp]
    page.run(
        "device.position.set(...value[0]); device.quaternion.set(...value[1])",
        [list(place), [float(x) for x in quaternion]],
    )


def eye_camera(eye: Json, begun: Doubles, start: Camera) -> Camera:
    """The camera of an eye if the head was at `begun` (4, 4), level, at the start."""
    transform = np.reshape(eye["transform"], (4, 4), order="F")
    projection = np.reshape(eye["projection"], (4, 4), order="F")
    # In the axes of the head at the start, with OpenCV's down and forward, then in the world.
    from_begun = np.linalg.inv(begun) @ transform
    flip = np.diag([1.0, -1.0, -1.0, 1.0])
    w2c = np.linalg.inv(flip @ from_begun @ flip) @ start.w2c
    width, height = eye["widthPx"], eye["heightPx"]
    lens = (
        width * projection[0, 0] / 2,
        height * projection[1, 1] / 2,
        width * (1 - projection[0, 2]) / 2,
        height * (1 + projection[1, 2]) / 2,
    )
    return Camera("eye", width, height, *lens, w2c)


def test_what_the_eyes_see(worn: Page, site: Site) -> None:
    place, yaw_rad = (0.4, 1.7, -0.3), 0.8
    turn_head(worn, place, yaw_rad, 0.0)
    begun = head_pose(place, yaw_rad, 0.0)
    worn.click("swings-player .headset")
    worn.wait(IN_HEADSET)
    assert worn.value("part('.headset').ariaPressed") == "true"

    reader = site.reader("whole")
    start = reader.manifest.camera()
    pictures = []
    for moved, yaw, pitch in ((place, yaw_rad, 0.0), ((0.2, 1.5, -1.0), 0.9, -0.2)):
        turn_head(worn, moved, yaw, pitch)
        eyes = worn.run("return window.readEyes(player)")
        middle = np.mean([np.reshape(eye["transform"], (4, 4), order="F") for eye in eyes], 0)
        np.testing.assert_allclose(middle, head_pose(moved, yaw, pitch), atol=1e-6)
        for eye in eyes:
            pictures.append(picture_of(eye))
            expected = expected_of(reader, eye_camera(eye, begun, start))
            assert psnr_db(pictures[-1], expected) >= LEAST_PSNR_DB
    for a, b in ((0, 1), (0, 2), (1, 3)):
        assert psnr_db(pictures[a], pictures[b]) < LEAST_PSNR_DB - 10


def test_it_plays_in_a_headset_and_goes_on_at_the_page(worn: Page, site: Site) -> None:
    worn.click("swings-player .headset")
    worn.wait(IN_HEADSET)
    for value in (1, 0):
        worn.run("device.controllers.right.updateButtonValue('trigger', value)", value)
        worn.run("await window.twoFrames(player.headset.session)")
    worn.wait("state.playing && state.frame > 2")
    worn.run("device.updateVisibilityState('hidden')")
    worn.wait("!state.playing")
    worn.run("device.updateVisibilityState('visible')")
    worn.wait("state.playing")
    worn.press("v")
    worn.wait("player.headset === null && part('.headset').ariaPressed === 'false'")
    frame = worn.value("player.shownFrame")
    worn.wait(f"player.shownFrame !== {frame}")
    worn.press("k")
    worn.press("Home")
    worn.wait("player.shownFrame === 0 && !state.playing")
    check_picture(worn, site.reader("whole"))


def test_a_viewer_who_asks_for_it_is_back_at_the_start(worn: Page, site: Site) -> None:
    worn.click("swings-player .headset")
    worn.wait(IN_HEADSET)
    first = worn.value("player.headset.last.w2c")
    start = site.reader("whole").manifest.camera().w2c
    np.testing.assert_allclose(np.reshape(first, (4, 4)), start, atol=1e-6)
    turn_head(worn, (0.2, 1.4, -1.0), 0.9, 0.0)
    worn.wait("Math.abs(player.headset.last.w2c[0] - 1) > 0.1")
    worn.run("device.recenter()")
    worn.wait(f"Math.hypot(...player.headset.last.w2c.map((x, i) => x - {first}[i])) < 1e-5")


@pytest.mark.parametrize(
    ("breakage", "says"),
    [
        ("navigator.xr.requestSession = async () => { throw new Error('not now') }", "not now"),
        (
            "WebGL2RenderingContext.prototype.makeXRCompatible = async function () {"
            "  this.canvas.dispatchEvent(new Event('webglcontextlost')) }",
            "another graphics device",
        ),
    ],
)
def test_a_headset_that_does_not_start(worn: Page, breakage: str, says: str) -> None:
    worn.run(breakage)
    worn.click("swings-player .headset")
    worn.wait(f"part('.note.soft').textContent.includes({says!r})")
    assert worn.value("player.headset === null && !device.activeSession")
    worn.press("k")
    worn.wait("state.frame > 2")


def test_without_a_headset(page: Page, site: Site) -> None:
    site.watch(page, "whole", size_px=SIZE_PX)
    assert page.value("part('.headset').hidden")
    page.run("element.focus()")
    page.press("v")
    page.wait("part('.note.soft').textContent.includes('headset')")
