"""The canvas of a player: the pixels of the screen, and no work when nothing changes. The WebGL
context of a page: lost, restored, lost forever, and shared by many players."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.support.web.canvas import (
    LEAST_PSNR_DB,
    PIXELS,
    canvas_of,
    check_picture,
    expected_of,
    held_picture_of,
    picture_of,
    psnr_db,
)
from tests.support.web.chromium import Page
from tests.support.web.site import Site

WIDTH_PX, HEIGHT_PX = 160, 120
COUNT_REQUESTS = """
window.numRequests = 0;
const { requestAnimationFrame } = window;
window.requestAnimationFrame = (action) => {
  window.numRequests += 1;
  return requestAnimationFrame(action);
};
"""
SETTLED = "player.isSettled && !player.view.needsDrawing && player.view.loop.waitedMs === 0"


def test_it_follows_the_pixel_ratio(page: Page, site: Site) -> None:
    site.watch(page, "whole")
    for ratio, drawn, less_px in ((1, 1, 0), (2, 2, 2), (1.5, 1.5, 4), (3, 2, 6), (1, 1, 0)):
        css_px = WIDTH_PX, HEIGHT_PX - less_px
        page.set_screen(*css_px, ratio)
        width_px, height_px = (round(drawn * px) for px in css_px)
        size = "player.view.size"
        page.wait(f"{size}.widthPx === {width_px} && {size}.heightPx === {height_px}")
        assert canvas_of(page).shape == (height_px, width_px, 3)
        check_picture(page, site.reader("whole"))


def test_it_rests_when_nothing_changes(page: Page, site: Site, tmp_path: Path) -> None:
    (tmp_path / "count.js").write_text(COUNT_REQUESTS)
    site.watch(page, "whole", scripts=(tmp_path / "count.js",))
    page.wait(SETTLED)
    wait_ms = "await new Promise((resolve) => setTimeout(resolve, 500));"
    assert page.run(f"numRequests = 0; {wait_ms} return numRequests") == 0
    before = canvas_of(page)
    page.wait(SETTLED)
    page.run("numRequests = 0; element.view = '0.5,0,1,0,0'")
    page.wait(f"numRequests >= 1 && {SETTLED}")
    assert page.value("numRequests") <= 3
    assert psnr_db(canvas_of(page), before) < 30


LOSE = """
window.extension = player.gl.getExtension("WEBGL_lose_context");
const lost = new Promise((resolve) => player.addEventListener("contextlost", resolve));
extension.loseContext();
await lost;
"""
NOTE = "part('.note.soft').textContent"


@pytest.fixture
def opened(page: Page, site: Site, tmp_path: Path) -> Page:
    """The page, paused at the first frame. Its time limits of 10 s last `limitMs` instead."""
    (tmp_path / "clock.js").write_text(
        "const { setTimeout } = window;"
        "window.limitMs = 10000;"
        "window.setTimeout = (action, ms) => setTimeout(action, ms === 10000 ? limitMs : ms);"
    )
    page.expect("loseContext")  # the browser logs this for a context that a script loses
    site.watch(page, "whole", scripts=(tmp_path / "clock.js",))
    return page


def test_a_lost_context_keeps_its_picture_and_plays_on(opened: Page) -> None:
    page = opened
    before = canvas_of(page)
    page.run("window.limitMs = 1e6")  # it comes back, even on a slow machine
    page.run(LOSE)
    page.run("player.motion.dragTurn(50, 0, 0); player.moved()")
    page.wait(f"{NOTE}.includes('waiting for it')")
    np.testing.assert_array_equal(held_picture_of(page), before)
    page.run("player.orbit.reset(); extension.restoreContext()")
    page.wait(f"player.renderer.numDrawn > 0 && {NOTE} === ''")
    np.testing.assert_array_equal(canvas_of(page), before)

    page.run("element.play()")
    page.wait("player.shownFrame > 5")
    page.run(LOSE)
    frame = page.value("player.shownFrame")
    page.wait("!element.paused && !state.playing")
    page.run("extension.restoreContext()")
    page.wait(f"player.shownFrame > {frame + 5} || player.shownFrame < {frame}")
    assert page.value("element.error") is None


def test_a_context_that_does_not_come_back(opened: Page) -> None:
    """The player reports it, and a retry draws the same frame with another context."""
    page = opened
    page.run("element.currentTime = 1")
    page.wait("player.shownFrame === 30 && !player.isSeeking")
    before = canvas_of(page)
    page.run("window.limitMs = 500")
    page.run(LOSE)
    page.wait("element.error.message.includes('did not come back')")
    np.testing.assert_array_equal(held_picture_of(page), before)
    page.run("element.retry()")
    page.wait("player.renderer.numDrawn > 0 && player.shownFrame === 30 && !player.isSeeking")
    np.testing.assert_array_equal(canvas_of(page), before)


TWO_ANSWERS = """
const block = (ms) => {
  const endMs = performance.now() + ms;
  while (performance.now() < endMs);
};
const { requestAnimationFrame } = window;
window.requestAnimationFrame = () => 1; // the browser lets nothing draw
player.view.loop.stop();
player.view.isEmpty = true;
player.resend();
block(value); // the sorter answers
player.motion.dragTurn(5, 0, 0);
player.view.loop.flush(); // asks for another order
block(value); // the sorter answers again
await new Promise((resolve) => setTimeout(resolve, 50)); // both answers arrive
window.requestAnimationFrame = requestAnimationFrame;
player.view.loop.stop();
player.view.redraw();
"""
"""Makes the sorter answer twice before the page draws, after `value` ms each, with all Gaussians in
the first answer."""


def test_two_answers_of_the_sorter_before_a_picture(opened: Page) -> None:
    for block_ms in (20, 100, 400):
        opened.wait("player.isSettled")
        opened.run(TWO_ANSWERS, block_ms)
        opened.wait("!player.view.isEmpty && player.isSettled")


MANY = """
await import("/player/player.js");
for (let i = 0; i < value; i++) {
  const made = document.createElement("swings-player");
  made.src = "whole";
  made.style = "position: absolute; width: 80px; height: 45px; " +
    `left: ${85 * (i % 5)}px; top: ${50 * Math.floor(i / 5)}px`;
  document.body.append(made);
}
"""
COUNT = """
window.contexts = new Set();
const { getContext } = HTMLCanvasElement.prototype;
HTMLCanvasElement.prototype.getContext = function (kind, ...rest) {
  const context = getContext.call(this, kind, ...rest);
  if (kind.startsWith("webgl")) window.contexts.add(context);
  return context;
};
"""


@pytest.mark.parametrize("count", [4, pytest.param(20, marks=pytest.mark.deep)])
def test_many_players_in_view(page: Page, site: Site, tmp_path: Path, count: int) -> None:
    """All of them play, each shows its picture, and the page has one WebGL context."""
    (tmp_path / "count.js").write_text(COUNT)
    page.open(site.write_page("bare.html", ""), 430, 200, scripts=(tmp_path / "count.js", PIXELS))
    page.run(MANY, count)
    every = "[...document.querySelectorAll('swings-player')].every"
    page.wait(f"{every}(({{ player }}) => player.shownFrame === 0)")
    assert page.value("contexts.size") == 1
    pictures = page.value(
        "Promise.all([...document.querySelectorAll('swings-player')]"
        ".map(({ player }) => readCanvas(player)))"
    )
    reader = site.reader("whole")
    expected = expected_of(reader, reader.manifest.camera().fitted(80, 45))
    assert len(pictures) == count
    for picture in pictures:
        assert psnr_db(picture_of(picture), expected) >= LEAST_PSNR_DB
    page.run("for (const one of document.querySelectorAll('swings-player')) one.play()")
    page.wait(f"{every}(({{ player }}) => player.shownFrame > 0)")
    assert page.value(f"{every}(({{ error }}) => error === null)")
