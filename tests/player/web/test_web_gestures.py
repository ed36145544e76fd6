"""After mouse and finger gestures and a resized window the page draws the CPU renderer's image."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from codec.camera import Camera
from codec.splats import SH_C0
from codec.stream import StreamReader
from player.render.cpu import render_splats
from tests.support.hosted_streams import ServerProcess
from tests.support.web.canvas import camera_of, check_picture
from tests.support.web.chromium import Page
from tests.support.web.site import Site

SIZE_PX = 480, 320
STILL = "!player.motion.isMoving"


def view_of(page: Page) -> tuple[float, float, float, float, float]:
    """Turn, tilt and zoom of the camera, and its movement to the right and down."""
    turn, tilt, zoom, right, down = map(float, page.value("player.orbit.text").split(","))
    return turn, tilt, zoom, right, down


def check_seen(page: Page, site: Site) -> None:
    """Asserts that the canvas shows the CPU renderer's picture from the page's camera."""
    check_picture(page, site.reader("whole"), camera=camera_of(page.value("player.camera")))


def test_a_mouse_turns_moves_and_comes_closer(page: Page, site: Site) -> None:
    site.watch(page, "whole", size_px=SIZE_PX)
    page.drag((240, 120), (300, 140))
    turn, tilt, *others = view_of(page)
    assert turn != 0
    assert tilt != 0
    assert others == [1, 0, 0]
    page.wait(STILL)
    assert view_of(page)[0] <= turn < 0  # it may have moved further
    turn, tilt, *_ = view_of(page)
    page.drag((240, 120), (200, 150), button="right")
    assert view_of(page)[:3] == (turn, tilt, 1)
    assert view_of(page)[3:] != (0, 0)
    page.press("+")
    assert view_of(page)[2] < 1
    page.wait(STILL)
    check_seen(page, site)
    page.press("r")
    page.wait(STILL)
    assert view_of(page) == (0, 0, 1, 0, 0)
    for width_px, height_px in ((400, 150), (195, 350)):
        page.resize(width_px, height_px)
        page.wait(f"player.canvas.width === {width_px} && player.canvas.height === {height_px}")
        check_seen(page, site)


def test_a_finger_turns_and_two_come_closer(page: Page, site: Site) -> None:
    site.watch(page, "whole", touch=True, size_px=SIZE_PX)
    page.touch([(200, 100)], [(220, 110)], [(260, 120)])
    turn, tilt, zoom, *_ = view_of(page)
    assert turn != 0
    assert tilt != 0
    assert zoom == 1
    page.wait(STILL)
    turn, tilt, *_ = view_of(page)
    page.touch(*([(240 - apart, 120), (240 + apart, 120)] for apart in (30, 45, 60)))
    page.wait(STILL)
    found = view_of(page)
    assert found[:2] == (turn, tilt)
    assert found[2] == pytest.approx(0.5, rel=0.1)
    check_seen(page, site)
    page.touch([(100, 100), (200, 100)], [(120, 130), (220, 130)], [(140, 160), (240, 160)])
    assert view_of(page)[3:] != found[3:]


WINDOWS_PX = (
    (390, 664), (390, 844), (412, 732), (844, 390), (800, 360), (768, 1024), (1280, 720),
    (1440, 789), (1440, 900), (1920, 969), (2560, 1440),
)  # fmt: skip
"""Phones with and without the browser's bars, a tablet, laptops and large screens."""


def check_all_gestures(page: Page, at_px: tuple[int, int]) -> None:
    """Asserts that a finger that moves turns the camera, and that the wheel comes closer."""
    x, y = at_px
    page.run("window.hints = []; element.addEventListener('gesturehint', () => hints.push(1))")
    page.touch([at_px], [(x - 40, y)], [(x - 96, y)])
    turn, _, zoom, *_ = view_of(page)
    assert turn > 0
    page.wheel(at_px)
    page.wait(f"Number(player.orbit.text.split(',')[2]) < {zoom}")
    assert page.value("window.hints") == []


@pytest.mark.parametrize("size_px", WINDOWS_PX, ids="{0[0]}x{0[1]}".format)
def test_one_finger_and_the_wheel_are_the_players_on_the_watch_page(
    page: Page, server: ServerProcess, size_px: tuple[int, int]
) -> None:
    page.open(f"{server.url}/watch/clip?autoplay=0", *size_px, touch=True)
    page.wait("player.shownFrame >= 0 && player.canvas.style.touchAction === 'none'")
    check_all_gestures(page, (size_px[0] // 2, size_px[1] // 4))  # above the large button


PART_OF_A_PAGE = """<div style="height: 320px; overflow: {overflow}">
<script type="module" src="player/player.js"></script>
<swings-player src="clip" style="width: 400px; height: 300px"></swings-player>
<p style="height: 400px"></p></div>"""


def test_a_small_player_has_them_where_nothing_scrolls(page: Page, site: Site) -> None:
    for overflow, action in ("auto", "pan-y"), ("hidden", "none"):
        page.open(
            site.write_page("part.html", PART_OF_A_PAGE.format(overflow=overflow)), touch=True
        )
        page.wait(f"player.shownFrame >= 0 && player.canvas.style.touchAction === '{action}'")
    check_all_gestures(page, (200, 60))
    page.run("document.body.style.paddingBottom = '3000px'")
    page.wait("player.canvas.style.touchAction === 'pan-y'")


SCROLLING = """
element.removeAttribute("gestures");
document.documentElement.style.overflow = document.body.style.overflow = "auto";
document.body.style.height = "auto";
element.style.height = "240px";
document.body.append(Object.assign(document.createElement("div"), { style: "height: 3000px" }));
window.hints = [];
element.addEventListener("gesturehint", ({ detail }) => window.hints.push(detail));
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


def test_a_page_scrolls_over_a_player(page: Page, site: Site) -> None:
    site.watch(page, "whole", touch=True, size_px=SIZE_PX)
    assert page.value("player.canvas.style.touchAction") == "none"
    page.run(SCROLLING)
    page.wait("player.canvas.style.touchAction === 'pan-y'")
    page.touch([(60, 140)], [(60, 90)], [(60, 10)])
    page.wait("window.scrollY > 0")
    page.run(SCROLL_BACK)
    page.touch([(100, 100)], [(160, 102)], [(240, 102)])
    page.wait("window.hints.length > 0")
    assert page.value("window.hints") == ["Use two fingers to look around"]
    assert view_of(page) == (0, 0, 1, 0, 0)
    page.touch([(100, 100), (200, 100)], [(120, 90), (220, 90)], [(160, 80), (260, 80)])
    turn, tilt, *others = view_of(page)
    assert turn < 0 < tilt
    assert others == pytest.approx([1, 0, 0], abs=1e-3)
    assert page.value("window.scrollY") == 0


def test_the_wheel_is_the_pages_until_a_click(page: Page, site: Site) -> None:
    wheel = """
    const event = new WheelEvent("wheel", { deltaY: -100, cancelable: true, ctrlKey: value });
    player.canvas.dispatchEvent(event);
    return event.defaultPrevented;
    """
    site.watch(page, "whole", size_px=SIZE_PX)
    assert page.run(wheel, False)
    page.run(SCROLLING)
    before = view_of(page)
    assert not page.run(wheel, False)
    assert page.value("window.hints") == ["Use Ctrl and the wheel to come closer"]
    assert view_of(page) == before
    assert page.run(wheel, True)
    page.drag((200, 100), (201, 100))
    assert page.run(wheel, False)
    assert view_of(page)[2] < before[2]


def test_a_double_click_with_alt_flies_to_what_shows_there(page: Page, site: Site) -> None:
    places_px = [(20 * x, 20 * y) for x in range(1, 24) for y in range(1, 16)]
    site.watch(page, "whole", size_px=SIZE_PX)
    camera = camera_of(page.value("player.camera"))
    depths_m, alphas = depths_of(site.reader("whole"), camera)
    code = (
        'const { depthAt } = await import("/web/renderer/depthquery.js");'
        "return value.map((at) => depthAt(player.renderer, player.camera, ...at))"
    )
    errors = []
    for (x, y), depth_m in zip(places_px, page.run(code, places_px), strict=True):
        if alphas[y, x] > 0.3:
            errors.append(abs(depth_m / depths_m[y, x] - 1))
        elif alphas[y, x] < 0.2:
            assert depth_m is None
    assert len(errors) > 20
    assert max(errors) < 0.02
    x, y = max(places_px, key=lambda place: alphas[place[1], place[0]])
    click = """const at = { clientX: value[0], clientY: value[1], altKey: true };
    player.canvas.dispatchEvent(new MouseEvent("dblclick", at));"""
    page.run(click, (x, y))
    page.wait(STILL)
    ray = np.array([(x - camera.cx_px) / camera.fx_px, (y - camera.cy_px) / camera.fy_px, 1])
    point = camera.position + depths_m[y, x] * ray @ camera.w2c[:3, :3]
    centre = page.value("player.orbit.centre")
    assert centre == pytest.approx(list(point), abs=0.03 * depths_m[y, x])
    check_seen(page, site)


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
