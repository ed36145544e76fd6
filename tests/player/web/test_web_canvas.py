"""The canvas of a player: the pixels of the screen, and no work when nothing changes."""

from __future__ import annotations

from pathlib import Path

from tests.support.web.canvas import canvas_of, check_picture, psnr_db
from tests.support.web.chromium import Page
from tests.support.web.site import Site

WIDTH_PX, HEIGHT_PX = 160, 120
COUNT = """
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
    (tmp_path / "count.js").write_text(COUNT)
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
