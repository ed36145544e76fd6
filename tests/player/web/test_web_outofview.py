"""Players out of view: they pause, keep no queue, and continue where they paused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.support.hosted_streams import static_host
from tests.support.web.canvas import PIXELS, canvas_of, held_picture_of
from tests.support.web.chromium import Page
from tests.support.web.site import Site

NUM_PLAYERS = 7
MOST_WAITING = 4
STYLE = """<link rel="icon" href="data:," />
<style>
  swings-player, iframe { display: block; width: 300px; height: 200px; border: 0; }
  .space { height: 3000px; }
</style>
"""
HIDDEN_PAGE = (
    STYLE
    + """<script>
  Object.defineProperty(document, "hidden", { get: () => window.isHidden, configurable: true });
  window.isHidden = true;
</script>
<script type="module" src="player/player.js"></script>
<swings-player src="clip" autoplay loop></swings-player>
<div class="space"></div>
"""
)
SHOW = "window.isHidden = false; document.dispatchEvent(new Event('visibilitychange'))"
OBSERVED = "await new Promise((seen) => new IntersectionObserver(seen).observe(element));"
"""Waits until the browser has told observers whether the player is in view."""


def test_a_frame_below_the_fold(page: Page, site: Site, tmp_path: Path) -> None:
    """In a page of another origin, no worker runs before the frame is scrolled into view. The
    player pauses when it is scrolled away, although the document is not hidden."""
    frame = f'<iframe src="{site.address("clip", "")}" allow="xr-spatial-tracking">'
    (tmp_path / "around.html").write_text(
        f'<!doctype html>{STYLE}<div class="space"></div>{frame}</iframe>'
        "<script>onmessage = ({ data }) => scrollTo(0, data);</script>"
    )
    with static_host(tmp_path) as around:
        page.open(f"{around}/around.html", 400, 300)
        page.enter("watch.html")
        page.wait("player !== undefined")
        assert page.run(f"{OBSERVED} return [document.hidden, player.workers]") == [False, None]
        page.run("parent.postMessage(3000, '*')")
        page.wait("player.shownFrame > 3")
        page.run("parent.postMessage(0, '*')")
        page.wait("!state.playing")
        page.wait_until_still("state.frame")
        number = page.value("state.frame")
        assert page.value("element.paused") is False
        page.run("parent.postMessage(3000, '*')")
        page.wait(f"state.playing && state.frame !== {number}")


@pytest.mark.parametrize("rest_s", [0, pytest.param(60, marks=pytest.mark.deep)])
def test_out_of_view_for_a_while(page: Page, site: Site, rest_s: int) -> None:
    """Memory stays the same as in view, within 10 %; picture in picture keeps a player playing."""
    page.open(site.write_page("hidden.html", HIDDEN_PAGE), 400, 300)
    page.wait("player !== undefined")
    page.run("await new Promise(requestAnimationFrame)")
    assert page.run(f"{OBSERVED} return player.workers") is None  # a page in the background
    page.run(SHOW)
    page.wait("state.playing && player.shownFrame > 20")
    in_view_bytes = sum(page.heaps_bytes())

    page.run("window.release = player.keepAlive(); scrollTo(0, 3000)")
    page.run(OBSERVED)
    frame = page.value("player.shownFrame")
    page.wait(f"player.shownFrame !== {frame}")
    page.run("release()")
    page.wait("!state.playing")

    page.wait_until_still("state.frame")
    frame = page.value("state.frame")
    page.run("await new Promise((resolve) => setTimeout(resolve, 1000 * value))", rest_s)
    assert sum(page.heaps_bytes()) < 1.1 * in_view_bytes
    assert page.value("state.frame") == frame
    page.run("scrollTo(0, 0)")
    page.wait(f"state.playing && state.frame !== {frame}")


MANY = """
isHidden = false;
element.removeAttribute("autoplay");
for (let i = 1; i < value; i++) {
  const made = document.createElement("swings-player");
  made.src = "clip";
  document.body.insertBefore(made, document.querySelector(".space"));
}
"""
OPEN = (
    "[...document.querySelectorAll('swings-player')].map(({ player }) => player.workers !== null)"
)


def test_a_player_that_is_parked(page: Page, site: Site) -> None:
    """The player that has been out of view longest keeps only its picture. In view it opens again,
    with its frame, camera and settings."""
    page.open(site.write_page("hidden.html", HIDDEN_PAGE), 400, 150, scripts=(PIXELS,))
    page.run(MANY, NUM_PLAYERS)
    page.run(SHOW)
    page.wait("player.shownFrame === 0")
    page.run("element.view = '0.3,0.1,1,0,0'; element.layers = 1; element.currentTime = 0.5")
    page.wait("player.shownFrame === 15 && !player.isSeeking && state.layers === 1")
    before = canvas_of(page)
    page.run("window.heard = []")
    for kind in ("parked", "unparked", "opened", "failed"):
        page.run("player.addEventListener(value, () => heard.push(value))", kind)
    for number in range(1, NUM_PLAYERS):
        page.run("scrollTo(0, 200 * value + 20)", number)
        page.wait(f"({OPEN})[{number}]")
    page.wait(f"({OPEN}).filter(Boolean).length === {MOST_WAITING + 1}")
    assert page.value("[heard, player.workers, player.renderer]") == [["parked"], None, None]
    np.testing.assert_array_equal(held_picture_of(page), before)
    page.run("scrollTo(0, 0)")
    page.wait("heard[1] === 'unparked' && player.renderer.numDrawn > 0")
    np.testing.assert_array_equal(canvas_of(page), before)
    found = page.value("[player.shownFrame, element.view, state.layers, heard]")
    assert found == [15, "0.3,0.1,1,0,0", 1, ["parked", "unparked"]]


@pytest.mark.deep
def test_twenty_players_take_the_memory_of_those_that_stay_open(page: Page, site: Site) -> None:
    """One player is in view and a few wait; each of the others has been in view and is parked."""
    found_bytes: list[int] = []
    for count in (MOST_WAITING + 1, 20):
        page.close()
        page.open(site.write_page("hidden.html", HIDDEN_PAGE), 400, 150)
        page.run(MANY, count)
        page.run(SHOW)
        for number in range(count):
            page.run("scrollTo(0, 200 * value + 20)", number)
            page.wait(
                f"document.querySelectorAll('swings-player')[{number}].player.shownFrame === 0"
            )
        page.wait(f"({OPEN}).filter(Boolean).length === {MOST_WAITING + 1}")
        found_bytes.append(sum(page.heaps_bytes()))
    assert found_bytes[1] < 1.1 * found_bytes[0]
