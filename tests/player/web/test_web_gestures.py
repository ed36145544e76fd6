"""After mouse and finger gestures and a resized window the page draws the CPU renderer's image."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from codec.camera import Camera
from codec.splats import SH_C0
from codec.stream import StreamReader
from codec.tools.static import export_static
from player.render.cpu import render_splats
from tests.support.hosted_streams import static_host, write_stream
from tests.support.web.browsercamera import from_browser
from tests.support.web.canvas import (
    LEAST_PSNR_DB,
    PIXELS,
    PLAYER,
    canvas_of,
    expected_of,
    psnr_db,
)
from tests.support.web.chromium import Page

ROOT = Path(__file__).parents[3]
WIDTH_PX, HEIGHT_PX = 480, 320

Opened = Callable[..., AbstractContextManager[Page]]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the page and a stream of 2,000 Gaussians a frame, all of them in one layer."""
    tmp_path = tmp_path_factory.mktemp("gestures")
    stream = write_stream(tmp_path / "stream", 20, slice_size=500, layers=(1.0,))
    export_static(stream, tmp_path / "static")
    (tmp_path / "web").symlink_to(ROOT / "player" / "web")
    return tmp_path


@pytest.fixture
def opened(page: Page, folder: Path) -> Opened:
    """Opens the page, paused at the first frame."""

    @contextmanager
    def opening(touch: bool = False) -> Iterator[Page]:
        with static_host(folder) as url:
            address = f"{url}/web/watch.html?src=../static&autoplay=0"
            page.open(address, WIDTH_PX, HEIGHT_PX, touch=touch, scripts=[PIXELS])
            page.wait(f"{PLAYER}?.shownFrame === 0", 60)
            yield page
            assert not page.complaints

    return opening


def view_of(page: Page) -> tuple[float, float, float, float, float]:
    """Turn, tilt and zoom of the camera, and its movement to the right and down."""
    turn, tilt, zoom, right, down = map(float, page.run(f"return {PLAYER}.orbit.text").split(","))
    return turn, tilt, zoom, right, down


def wait_until_still(page: Page) -> None:
    page.wait(f"!{PLAYER}.motion.isMoving")


def check_picture(page: Page, folder: Path) -> None:
    """Asserts that the canvas shows the CPU renderer's picture from the page's camera."""
    camera = from_browser(page.run(f"return {PLAYER}.camera"))
    expected = expected_of(StreamReader(folder / "stream"), camera)
    assert psnr_db(canvas_of(page), expected) >= LEAST_PSNR_DB


def test_a_mouse_turns_moves_and_comes_closer(opened: Opened, folder: Path) -> None:
    with opened() as page:
        page.drag((240, 120), (300, 140))
        turn, tilt, *others = view_of(page)
        assert turn != 0
        assert tilt != 0
        assert others == [1, 0, 0]
        wait_until_still(page)
        assert view_of(page)[0] <= turn < 0  # it may have moved further
        turn, tilt, *_ = view_of(page)
        page.drag((240, 120), (200, 150), button="right")
        assert view_of(page)[:3] == (turn, tilt, 1)
        assert view_of(page)[3:] != (0, 0)
        page.press("+")
        assert view_of(page)[2] < 1
        wait_until_still(page)
        check_picture(page, folder)
        page.press("r")
        wait_until_still(page)
        assert view_of(page) == (0, 0, 1, 0, 0)


def test_a_finger_turns_and_two_come_closer(opened: Opened, folder: Path) -> None:
    with opened(touch=True) as page:
        page.touch([(200, 100)], [(220, 110)], [(260, 120)])
        turn, tilt, zoom, *_ = view_of(page)
        assert turn != 0
        assert tilt != 0
        assert zoom == 1
        wait_until_still(page)
        turn, tilt, *_ = view_of(page)
        page.touch(*([(240 - apart, 120), (240 + apart, 120)] for apart in (30, 45, 60)))
        wait_until_still(page)
        found = view_of(page)
        assert found[:2] == (turn, tilt)
        assert found[2] == pytest.approx(0.5, rel=0.1)
        check_picture(page, folder)
        page.touch([(100, 100), (200, 100)], [(120, 130), (220, 130)], [(140, 160), (240, 160)])
        assert view_of(page)[3:] != found[3:]


@pytest.mark.parametrize(("width_px", "height_px"), [(800, 300), (390, 700)])
def test_a_window_of_another_size(
    opened: Opened, folder: Path, width_px: int, height_px: int
) -> None:
    with opened() as page:
        page.resize(width_px, height_px)
        page.wait(f"{PLAYER}.canvas.width === {width_px} && {PLAYER}.canvas.height === {height_px}")
        check_picture(page, folder)
        page.resize(WIDTH_PX, HEIGHT_PX)
        page.wait(f"{PLAYER}.canvas.width === {WIDTH_PX}")
        check_picture(page, folder)


SCROLLING = """
document.documentElement.style.overflow = document.body.style.overflow = "auto";
document.body.style.height = "auto";
const player = document.querySelector("swings-player");
player.style.height = "240px";
document.body.append(Object.assign(document.createElement("div"), { style: "height: 3000px" }));
window.hints = [];
player.addEventListener("gesturehint", ({ detail }) => window.hints.push(detail));
"""
"""Makes the page scrollable, with the player at its top."""


SCROLL_BACK = """
const picture = () => new Promise(requestAnimationFrame);
for (let [still, last] = [0, -1]; still < 10; last = window.scrollY) {
  await picture();
  still = window.scrollY === last ? still + 1 : 0;
}
window.scrollTo(0, 0);
for (let i = 0; i < 3; i++) await picture();
"""
"""Waits until the page stands still, because a touch that stops it is no gesture, then scrolls to
its top."""


def test_a_page_scrolls_over_a_player(opened: Opened) -> None:
    canvas = f"{PLAYER}.canvas"
    with opened(touch=True) as page:
        assert page.run(f"return {canvas}.style.touchAction") == "none"
        page.run(SCROLLING)
        page.wait(f"{canvas}.style.touchAction === 'pan-y'")
        page.touch([(60, 140)], [(60, 90)], [(60, 10)])
        page.wait("window.scrollY > 0")
        page.run(SCROLL_BACK)
        page.touch([(100, 100)], [(160, 102)], [(240, 102)])
        page.wait("window.hints.length > 0")
        assert page.run("return window.hints") == ["Use two fingers to look around"]
        assert view_of(page) == (0, 0, 1, 0, 0)
        page.touch([(100, 100), (200, 100)], [(120, 90), (220, 90)], [(160, 80), (260, 80)])
        turn, tilt, *others = view_of(page)
        assert turn < 0 < tilt
        assert others == pytest.approx([1, 0, 0], abs=1e-3)
        assert page.run("return window.scrollY") == 0


def test_the_wheel_is_the_pages_until_a_click(opened: Opened) -> None:
    wheel = f"""
    const event = new WheelEvent("wheel", {{ deltaY: -100, cancelable: true, ctrlKey: value }});
    {PLAYER}.canvas.dispatchEvent(event);
    return event.defaultPrevented;
    """
    with opened() as page:
        assert page.run(wheel, False)
        page.run(SCROLLING)
        before = view_of(page)
        assert not page.run(wheel, False)
        assert page.run("return window.hints") == ["Use Ctrl and the wheel to come closer"]
        assert view_of(page) == before
        assert page.run(wheel, True)
        page.drag((200, 100), (201, 100))
        assert page.run(wheel, False)
        assert view_of(page)[2] < before[2]


def test_a_double_click_with_alt_flies_to_what_shows_there(opened: Opened, folder: Path) -> None:
    places_px = [(40 * x, 40 * y) for x in range(1, 12) for y in range(1, 8)]
    with opened() as page:
        camera = from_browser(page.run(f"return {PLAYER}.camera"))
        depths_m, alphas = depths_of(StreamReader(folder / "stream"), camera)
        code = f"return value.map((at) => {PLAYER}.renderer.depthAt({PLAYER}.camera, ...at))"
        found = page.run(code, places_px)
        errors = []
        for (x, y), depth_m in zip(places_px, found, strict=True):
            if alphas[y, x] > 0.3:
                errors.append(abs(depth_m / depths_m[y, x] - 1))
            elif alphas[y, x] < 0.2:
                assert depth_m is None
        assert len(errors) > 20
        assert max(errors) < 0.02
        x, y = max(places_px, key=lambda place: alphas[place[1], place[0]])
        page.run(
            f"""const at = {{ clientX: value[0], clientY: value[1], altKey: true }};
            {PLAYER}.canvas.dispatchEvent(new MouseEvent("dblclick", at));""",
            (x, y),
        )
        wait_until_still(page)
        ray = np.array([(x - camera.cx_px) / camera.fx_px, (y - camera.cy_px) / camera.fy_px, 1])
        point = camera.position + depths_m[y, x] * ray @ camera.w2c[:3, :3]
        centre = page.run(f"return {PLAYER}.orbit.centre")
        assert centre == pytest.approx(list(point), abs=0.03 * depths_m[y, x])
        check_picture(page, folder)


def depths_of(
    reader: StreamReader, camera: Camera
) -> tuple[npt.NDArray[np.floating], npt.NDArray[np.floating]]:
    """(height, width) mean depth of the visible Gaussians in metres, and their opacity."""
    splats = reader.active_splats(0, reader.manifest.num_layers)
    z = splats.means @ camera.w2c[2, :3] + camera.w2c[2, 3]
    drawn = []
    for colour in (z, np.ones_like(z)):
        sh = np.zeros_like(splats.sh)
        sh[:, 0] = (colour[:, None] - 0.5) / SH_C0
        picture = render_splats(replace(splats, sh=sh), camera, reader.manifest.near_m)
        drawn.append(picture[..., 0])
    return drawn[0] / np.maximum(drawn[1], 1e-6), drawn[1]
