"""Players out of view: they pause, keep no queue, and continue where they paused."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from codec.tools.static import export_static
from tests.support.hosted_streams import static_host
from tests.support.slots.slot_streams import write_busy_stream
from tests.support.slots.updates import small_layout
from tests.support.web.canvas import ELEMENT, PIXELS, PLAYER, STATE, canvas_of, picture_of
from tests.support.web.chromium import Page

ROOT = Path(__file__).parents[3]
NUM_FRAMES = 45
NUM_PLAYERS = 7
MOST_WAITING = 4

PAGE = """<!doctype html>
<link rel="icon" href="data:," />
<style>
  swings-player, iframe { display: block; width: 300px; height: 200px; border: 0; }
  .space { height: 3000px; }
</style>
"""
ELEMENT_PAGE = (
    PAGE
    + """<script>
  Object.defineProperty(document, "hidden", { get: () => window.isHidden, configurable: true });
  window.isHidden = true;
</script>
<script type="module" src="web/element/swingsplayer.js"></script>
<swings-player src="static" autoplay loop></swings-player>
<div class="space"></div>
"""
)
SHOW = "window.isHidden = false; document.dispatchEvent(new Event('visibilitychange'))"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The player in web/, a stream in static/, and a page with a player, hidden at first."""
    path = tmp_path_factory.mktemp("outofview")
    write_busy_stream(path / "stream", NUM_FRAMES, small_layout(1, (200, 200, 100), 0, 15))
    export_static(path / "stream", path / "static")
    (path / "web").symlink_to(ROOT / "player" / "web")
    (path / "element.html").write_text(ELEMENT_PAGE)
    return path


@pytest.fixture
def url(folder: Path) -> Iterator[str]:
    with static_host(folder) as url:
        yield url


def test_a_frame_below_the_fold(page: Page, url: str, tmp_path: Path) -> None:
    """In a page of another origin, no worker runs before the frame is scrolled into view. The
    player pauses when it is scrolled away, although the document is not hidden."""
    frame = f'<iframe src="{url}/web/watch.html?src=../static" allow="xr-spatial-tracking">'
    (tmp_path / "around.html").write_text(
        f'{PAGE}<div class="space"></div>{frame}</iframe>'
        "<script>onmessage = ({ data }) => scrollTo(0, data);</script>"
    )
    with static_host(tmp_path) as around:
        page.open(f"{around}/around.html", 400, 300)
        page.enter("watch.html")
        page.wait(f"{PLAYER} !== undefined")
        time.sleep(1)
        assert page.run(f"return [document.hidden, {PLAYER}.workers]") == [False, None]
        page.run("parent.postMessage(3000, '*')")
        page.wait(f"{PLAYER}.shownFrame > 3", 60)
        page.run("parent.postMessage(0, '*')")
        page.wait(f"!{STATE}.playing")
        time.sleep(0.5)  # time to notify the worker
        number = page.run(f"return {STATE}.frame")
        time.sleep(0.5)
        assert page.run(f"return [{STATE}.frame, {ELEMENT}.paused]") == [number, False]
        page.run("parent.postMessage(3000, '*')")
        page.wait(f"{STATE}.playing && {STATE}.frame !== {number}")
        assert not page.complaints


@pytest.mark.parametrize("rest_s", [2, pytest.param(60, marks=pytest.mark.slow)])
def test_out_of_view_for_a_while(page: Page, url: str, rest_s: int) -> None:
    """Memory stays the same as in view, within 10 %; picture in picture keeps a player playing."""
    page.open(f"{url}/element.html", 400, 300)
    page.wait(f"{PLAYER} !== undefined")
    time.sleep(0.5)
    assert page.run(f"return {PLAYER}.workers") is None  # a page in the background
    page.run(SHOW)
    page.wait(f"{STATE}.playing && {PLAYER}.shownFrame > 20", 60)
    in_view_bytes = sum(page.heaps_bytes())

    page.run(f"window.release = {PLAYER}.keepAlive(); scrollTo(0, 3000)")
    frame = page.run(f"return {PLAYER}.shownFrame")
    page.wait(f"{PLAYER}.shownFrame !== {frame}")
    time.sleep(0.5)
    frame = page.run(f"return {PLAYER}.shownFrame")
    page.wait(f"{PLAYER}.shownFrame !== {frame}")
    page.run("release()")
    page.wait(f"!{STATE}.playing")

    time.sleep(rest_s)
    frame = page.run(f"return {STATE}.frame")
    assert sum(page.heaps_bytes()) < 1.1 * in_view_bytes
    assert page.run(f"return {STATE}.frame") == frame
    page.run("scrollTo(0, 0)")
    page.wait(f"{STATE}.playing && {STATE}.frame !== {frame}")
    assert not page.complaints


MANY = """
isHidden = false;
document.querySelector("swings-player").removeAttribute("autoplay");
for (let i = 1; i < value; i++) {
  const player = document.createElement("swings-player");
  player.src = "static";
  document.body.insertBefore(player, document.querySelector(".space"));
}
"""
OPEN = (
    "[...document.querySelectorAll('swings-player')].map(({ player }) => player.workers !== null)"
)


def test_a_player_that_is_parked(page: Page, url: str) -> None:
    """The player that has been out of view longest keeps only its picture. In view it opens again,
    with its frame, camera and settings."""
    page.open(f"{url}/element.html", 400, 150, scripts=(PIXELS,))
    page.run(MANY, NUM_PLAYERS)
    page.run(SHOW)
    page.wait(f"{PLAYER}.shownFrame === 0", 60)
    page.run(f"{ELEMENT}.view = '0.3,0.1,1,0,0'; {ELEMENT}.layers = 1; {ELEMENT}.currentTime = 0.5")
    page.wait(f"{PLAYER}.shownFrame === 15 && !{PLAYER}.isSeeking && {STATE}.layers === 1", 30)
    before = canvas_of(page)
    page.run("window.heard = []")
    for kind in ("parked", "unparked", "opened", "failed"):
        page.run(f"{PLAYER}.addEventListener(value, () => heard.push(value))", kind)
    for number in range(1, NUM_PLAYERS):
        page.run("scrollTo(0, 200 * value + 20)", number)
        page.wait(f"({OPEN})[{number}]")
    page.wait(f"({OPEN}).filter(Boolean).length === {MOST_WAITING + 1}")
    assert page.run(f"return [heard, {PLAYER}.workers, {PLAYER}.renderer]") == [
        ["parked"],
        None,
        None,
    ]
    held = picture_of(page.run(f"return shownPixels({PLAYER}.canvas)"))
    np.testing.assert_array_equal(held, before)
    page.run("scrollTo(0, 0)")
    page.wait(f"heard[1] === 'unparked' && {PLAYER}.renderer.numDrawn > 0", 30)
    np.testing.assert_array_equal(canvas_of(page), before)
    found = page.run(f"return [{PLAYER}.shownFrame, {ELEMENT}.view, {STATE}.layers, heard]")
    assert found == [15, "0.3,0.1,1,0,0", 1, ["parked", "unparked"]]
    assert not page.complaints


@pytest.mark.slow
def test_twenty_players_take_the_memory_of_those_that_stay_open(page: Page, url: str) -> None:
    """One player is in view and a few wait; each of the others has been in view and is parked."""
    found_bytes: list[int] = []
    for count in (MOST_WAITING + 1, 20):
        page.open(f"{url}/element.html", 400, 150)
        page.run(MANY, count)
        page.run(SHOW)
        for number in range(count):
            page.run("scrollTo(0, 200 * value + 20)", number)
            player = f"document.querySelectorAll('swings-player')[{number}].player"
            page.wait(f"{player}?.shownFrame === 0", 60)
        page.wait(f"({OPEN}).filter(Boolean).length === {MOST_WAITING + 1}")
        found_bytes.append(sum(page.heaps_bytes()))
    assert found_bytes[1] < 1.1 * found_bytes[0]
    assert not page.complaints
