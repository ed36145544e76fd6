"""The page for two eyes: side by side, and on an emulated headset."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from codec.camera import Camera
from codec.pose import rotation_about, world_to_camera
from codec.stream.reader import StreamReader
from codec.tools.static import export_static
from tests.support.hosted_streams import static_host, write_stream
from tests.support.web.browsercamera import from_browser
from tests.support.web.canvas import (
    ELEMENT,
    LEAST_PSNR_DB,
    PIXELS,
    PLAYER,
    STATE,
    Doubles,
    canvas_of,
    expected_of,
    picture_of,
    psnr_db,
)
from tests.support.web.chromium import Page
from tests.support.web.nodeprocess import SCRIPTS, Json

HERE = Path(__file__).parent
ROOT = Path(__file__).parents[4]
EMULATOR = SCRIPTS / "node_modules" / "iwer" / "build" / "iwer.min.js"
NUM_FRAMES = 60
EMULATED_EYES_M = 1.6
WIDTH_PX, HEIGHT_PX = 640, 320


def part(selector: str) -> str:
    return f"{ELEMENT}.shadowRoot.querySelector('{selector}')"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the page and a stream with view-dependent colours."""
    tmp_path = tmp_path_factory.mktemp("stereo")
    stream = write_stream(tmp_path / "stream", NUM_FRAMES, slice_size=200, layers=(1.0,))
    export_static(stream, tmp_path / "static")
    (tmp_path / "web").symlink_to(ROOT / "player" / "web")
    return tmp_path


@pytest.fixture(scope="module")
def reader(folder: Path) -> StreamReader:
    return StreamReader(folder / "stream")


@pytest.fixture
def opened(page: Page, folder: Path) -> Callable[..., AbstractContextManager[Page]]:
    """Opens the page, paused at the first frame."""

    @contextmanager
    def opening(*scripts: Path) -> Iterator[Page]:
        with static_host(folder) as url:
            address = f"{url}/web/watch.html?src=../static&autoplay=0"
            page.open(address, WIDTH_PX, HEIGHT_PX, scripts=(*scripts, PIXELS))
            page.wait(f"{PLAYER}?.shownFrame === 0", 60)
            yield page
            assert not page.complaints

    return opening


@pytest.fixture
def worn(opened: Callable[..., AbstractContextManager[Page]]) -> Iterator[Page]:
    """The page with a headset."""
    if not EMULATOR.is_file():
        pytest.skip("needs the emulator of headsets: scripts/setup dev")
    with opened(EMULATOR, HERE / "headset.js") as page:
        yield page


def aside(camera: Camera, aside_m: float) -> Camera:
    """The same camera, moved to its right."""
    return replace(
        camera, w2c=world_to_camera(camera.w2c[:3, :3], camera.position + aside_m * camera.right)
    )


def test_side_by_side(
    opened: Callable[..., AbstractContextManager[Page]], reader: StreamReader, tmp_path: Path
) -> None:
    with opened() as page:
        alone = page.run(f"return window.readCanvas({PLAYER})")
        page.click("swings-player .side-by-side")
        assert page.run(f"return {part('.side-by-side')}.ariaPressed") == "true"
        both = canvas_of(page)
        half = from_browser(page.run(f"return {PLAYER}.camera"))
        page.screenshot(tmp_path / "side-by-side.png")
        page.press("e")
        again = page.run(f"return window.readCanvas({PLAYER})")
    assert again == alone
    whole = reader.manifest.camera().fitted(WIDTH_PX, HEIGHT_PX)
    assert psnr_db(picture_of(alone), expected_of(reader, whole)) >= LEAST_PSNR_DB
    assert (half.width_px, half.height_px) == (WIDTH_PX // 2, HEIGHT_PX)
    # The scene's centre is 4 m away, and shows at the same place to both eyes.
    pictures = {}
    for side, picture in zip((-0.5, 0.5), np.split(both, 2, axis=1), strict=True):
        eye = aside(half, side * 0.063)
        eye = replace(eye, cx_px=half.cx_px + half.fx_px * side * 0.063 / 4)
        pictures[side] = expected_of(reader, eye)
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


def test_what_the_eyes_see(worn: Page, reader: StreamReader) -> None:
    place, yaw_rad = (0.4, 1.7, -0.3), 0.8
    turn_head(worn, place, yaw_rad, 0.0)
    begun = head_pose(place, yaw_rad, 0.0)
    worn.click("swings-player .headset")
    worn.wait(f"{PLAYER}.headset?.last")
    assert worn.run(f"return {part('.headset')}.ariaPressed") == "true"

    start = reader.manifest.camera()
    views = {}
    for name, moved, yaw, pitch in (
        ("begun", place, yaw_rad, 0.0),
        ("moved", (0.2, 1.5, -1.0), 0.9, -0.2),
    ):
        turn_head(worn, moved, yaw, pitch)
        views[name] = worn.run(f"return window.readEyes({PLAYER})")
        middle = np.mean(
            [np.reshape(eye["transform"], (4, 4), order="F") for eye in views[name]], 0
        )
        np.testing.assert_allclose(middle, head_pose(moved, yaw, pitch), atol=1e-6)
        for eye in views[name]:
            expected = expected_of(reader, eye_camera(eye, begun, start))
            assert psnr_db(picture_of(eye), expected) >= LEAST_PSNR_DB
    pictures = [picture_of(eye) for eye in views["begun"] + views["moved"]]
    for a, b in ((0, 1), (0, 2), (1, 3)):
        assert psnr_db(pictures[a], pictures[b]) < LEAST_PSNR_DB - 10


def test_it_plays_in_a_headset_and_goes_on_at_the_page(worn: Page, reader: StreamReader) -> None:
    worn.click("swings-player .headset")
    worn.wait(f"{PLAYER}.headset?.last")
    for value in (1, 0):
        worn.run("device.controllers.right.updateButtonValue('trigger', value)", value)
        worn.run(f"await window.twoFrames({PLAYER}.headset.session)")
    worn.wait(f"{STATE}.playing && {STATE}.frame > 2", 60)
    worn.run("device.updateVisibilityState('hidden')")
    worn.wait(f"!{STATE}.playing")
    worn.run("device.updateVisibilityState('visible')")
    worn.wait(f"{STATE}.playing")
    worn.press("v")
    worn.wait(f"{PLAYER}.headset === null && {part('.headset')}.ariaPressed === 'false'")
    frame = worn.run(f"return {PLAYER}.shownFrame")
    worn.wait(f"{PLAYER}.shownFrame !== {frame}")
    worn.press("k")
    worn.press("Home")
    worn.wait(f"{PLAYER}.shownFrame === 0 && !{STATE}.playing", 30)
    found = canvas_of(worn)
    whole = reader.manifest.camera().fitted(WIDTH_PX, HEIGHT_PX)
    assert psnr_db(found, expected_of(reader, whole)) >= LEAST_PSNR_DB


def test_a_viewer_who_asks_for_it_is_back_at_the_start(worn: Page, reader: StreamReader) -> None:
    worn.click("swings-player .headset")
    worn.wait(f"{PLAYER}.headset?.last")
    first = worn.run(f"return {PLAYER}.headset.last.w2c")
    np.testing.assert_allclose(np.reshape(first, (4, 4)), reader.manifest.camera().w2c, atol=1e-6)
    turn_head(worn, (0.2, 1.4, -1.0), 0.9, 0.0)
    worn.wait(f"Math.abs({PLAYER}.headset.last.w2c[0] - 1) > 0.1")
    worn.run("device.recenter()")
    worn.wait(f"Math.hypot(...{PLAYER}.headset.last.w2c.map((x, i) => x - {first}[i])) < 1e-5")


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
    worn.wait(f"{part('.note.soft')}.textContent.includes({says!r})")
    assert worn.run(f"return {PLAYER}.headset === null && !device.activeSession")
    worn.press("k")
    worn.wait(f"{STATE}.frame > 2", 60)


def test_without_a_headset(opened: Callable[..., AbstractContextManager[Page]]) -> None:
    with opened() as page:
        assert page.run(f"return {part('.headset')}.hidden")
        page.run(f"{ELEMENT}.focus()")
        page.press("v")
        page.wait(f"{part('.note.soft')}.textContent.includes('headset')")
