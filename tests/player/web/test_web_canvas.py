"""The canvas of a player: the pixels of the screen, and no work when nothing changes."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from codec.stream.reader import StreamReader
from codec.tools.static import export_static
from tests.support.hosted_streams import static_host, write_stream
from tests.support.web.canvas import (
    ELEMENT,
    LEAST_PSNR_DB,
    PIXELS,
    PLAYER,
    canvas_of,
    expected_of,
    psnr_db,
)
from tests.support.web.chromium import Page

ROOT = Path(__file__).parents[3]
WIDTH_PX, HEIGHT_PX = 320, 240

COUNT = """
window.numRequests = 0;
const { requestAnimationFrame } = window;
window.requestAnimationFrame = (action) => {
  window.numRequests += 1;
  return requestAnimationFrame(action);
};
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The player in web/ and a stream in static/."""
    path = tmp_path_factory.mktemp("canvas")
    write_stream(path / "stream", 30, slice_size=100, layers=(1.0,))
    export_static(path / "stream", path / "static")
    (path / "web").symlink_to(ROOT / "player" / "web")
    (path / "count.js").write_text(COUNT)
    return path


@pytest.fixture
def opened(page: Page, folder: Path) -> Iterator[Page]:
    """The page, paused at the first frame."""
    with static_host(folder) as url:
        address = f"{url}/web/watch.html?src=../static&autoplay=0"
        page.open(address, WIDTH_PX, HEIGHT_PX, scripts=(folder / "count.js", PIXELS))
        page.wait(f"{PLAYER}?.shownFrame === 0", 60)
        yield page
        assert not page.complaints


def test_it_follows_the_pixel_ratio(opened: Page, folder: Path) -> None:
    reader = StreamReader(folder / "stream")
    whole = reader.manifest.camera()
    for ratio, drawn, less_px in ((1, 1, 0), (2, 2, 2), (1.5, 1.5, 4), (3, 2, 6), (1, 1, 0)):
        css_px = WIDTH_PX, HEIGHT_PX - less_px
        width_px, height_px = (round(drawn * px) for px in css_px)
        opened.set_screen(*css_px, ratio)
        size = f"{PLAYER}.view.size"
        opened.wait(f"{size}.widthPx === {width_px} && {size}.heightPx === {height_px}")
        picture = canvas_of(opened)
        assert picture.shape == (height_px, width_px, 3)
        expected = expected_of(reader, whole.fitted(width_px, height_px))
        assert psnr_db(picture, expected) >= LEAST_PSNR_DB


def test_it_rests_when_nothing_changes(opened: Page) -> None:
    settled = (
        f"{PLAYER}.isSettled && !{PLAYER}.view.needsDrawing && {PLAYER}.view.loop.waitedMs === 0"
    )
    opened.wait(settled)
    wait_ms = "await new Promise((resolve) => setTimeout(resolve, 500));"
    assert opened.run(f"numRequests = 0; {wait_ms} return numRequests") == 0
    before = canvas_of(opened)
    opened.wait(settled)
    opened.run(f"numRequests = 0; {ELEMENT}.view = '0.5,0,1,0,0'")
    opened.wait(f"numRequests >= 1 && {settled}")
    assert opened.run("return numRequests") <= 3
    assert psnr_db(canvas_of(opened), before) < 30
