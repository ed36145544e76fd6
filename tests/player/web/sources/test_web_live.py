"""Live streams in the browser: joining, growth and end."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from PIL import Image

from codec.files import write_atomic
from codec.stream.manifest import MANIFEST_NAME
from codec.tools.static import export_static
from tests.support.hosted_streams import served, write_stream
from tests.support.slots.slot_streams import write_busy_stream
from tests.support.slots.updates import small_layout
from tests.support.suite.once import made_once
from tests.support.web.chromium import Page
from tests.support.web.publisher import Publisher
from tests.support.web.site import player_host, watch

NOTE = "part('.note.soft').textContent"
BEHIND = "part('.badge').classList.contains('behind')"
NUM_FRAMES = 180
SEGMENT_FRAMES = 15


def make(folder: Path) -> None:
    """A finished export of 6 s, in segments of half a second, and one of whole slices."""
    layout = small_layout(1, (40, 20), 0, SEGMENT_FRAMES)
    write_busy_stream(folder / "stream", NUM_FRAMES, layout)
    export_static(folder / "stream", folder / "static")
    export_static(write_stream(folder / "slices", 40), folder / "whole")


@pytest.fixture
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return made_once(tmp_path_factory, "web-live", make)


@pytest.fixture
def publisher(made: Path, tmp_path: Path) -> Publisher:
    return Publisher(made / "static", tmp_path / "live")


@pytest.fixture
def url(tmp_path: Path) -> Iterator[str]:
    with player_host(tmp_path) as host:
        yield f"{host}/player/watch.html?src=../live&loop=0"


WATCH_FRAMES = """
window.framesShown = [];
const note = () => {
  const { shownFrame } = element.player;
  if (framesShown.at(-1) !== shownFrame) framesShown.push(shownFrame);
  requestAnimationFrame(note);
};
note();
"""
"""Records every shown frame from now on."""


def test_a_stream_that_grows_plays_at_its_edge_until_it_ends(
    page: Page, publisher: Publisher, url: str
) -> None:
    publisher.publish(6)
    watch(page, url, 480, 320)
    assert page.value("player.shownFrame") >= 45  # 90 less 45
    page.run(WATCH_FRAMES)
    page.wait("part('.badge')?.hidden === false")
    assert not page.value(BEHIND)
    page.wait("part('.time').textContent === ''")  # the badge says it
    publisher.publish(4)
    page.wait("player.numFrames === 150 && player.shownFrame >= 90")
    frames = page.value("framesShown")
    assert frames == sorted(frames)
    page.wait("Number(part('.scrub').max) >= 149 && part('.scrub').value >= 90")
    page.run("element.focus()")
    page.click("swings-player canvas")
    page.press("o")
    assert not page.value("element.loop"), "it has no end yet"
    for way in ("badge", "key"):
        if page.value("state.playing"):
            page.press("k")
        page.press("Home")
        page.wait(f"player.shownFrame === 0 && {BEHIND}")
        if way == "badge":
            page.click("swings-player .badge")
        else:
            page.press("End")
        page.wait(f"player.shownFrame >= 90 && state.playing && !{BEHIND}")
    page.run(WATCH_FRAMES)
    publisher.finish()
    page.run("player.setRate(4)")
    page.wait("!player.live && part('.badge').hidden")
    page.wait(f"player.shownFrame === {NUM_FRAMES - 1} && !state.playing")
    frames = page.value("framesShown")
    assert frames == sorted(frames)


def test_a_stream_is_waited_for_before_it_begins_and_while_there_is_no_network(
    page: Page, publisher: Publisher, url: str, tmp_path: Path
) -> None:
    page.expect("ERR_INTERNET_DISCONNECTED")
    manifest = replace(publisher.manifest, poster="poster.png")
    write_atomic(tmp_path / "live" / MANIFEST_NAME, manifest.to_json())
    page.open(url, 160, 120)
    page.wait(f"{NOTE}.includes('has no frames yet')")
    page.run("element.poster = new URL('../live/poster.png', location).href")
    for width_px in (8, 16):  # a training renews it
        Image.new("RGB", (width_px, 8)).save(tmp_path / "live" / "poster.png")
        page.wait(f"part('.poster').naturalWidth === {width_px}")
    publisher.publish(3)
    page.wait(f"player.shownFrame >= 0 && {NOTE} === ''")
    page.run(WATCH_FRAMES)
    page.set_offline(True)
    publisher.publish(4)
    # It shows the data that it had, and waits.
    page.wait(f"state.waiting && {NOTE}.includes('trying again')")
    assert page.value("player.numFrames") == 45
    page.set_offline(False)
    page.wait(f"player.numFrames === 105 && player.shownFrame > 60 && {NOTE} === ''")
    page.set_offline(True)
    publisher.finish()
    page.set_offline(False)
    page.wait(f"!player.live && player.numFrames === {NUM_FRAMES}")
    page.wait("player.shownFrame > 110")
    frames = page.value("framesShown")
    assert frames == sorted(frames)


@pytest.mark.parametrize(("query", "first"), [("&t=1", 30), ("&t=0", 0)])
def test_a_start_that_is_asked_for_is_where_it_starts(
    page: Page, publisher: Publisher, url: str, query: str, first: int
) -> None:
    publisher.publish(12)
    watch(page, f"{url}&autoplay=0{query}")
    page.wait(f"player.shownFrame === {first}")
    page.wait(BEHIND if first == 0 else "part('.badge').hidden === false")


AWAY: dict[str, tuple[Callable[[Page], object], Callable[[Page], object]]] = {
    "paused": (lambda page: page.press("k"), lambda page: page.click("swings-player .badge")),
    "wound back": (lambda page: [*map(page.press, ("k", "Home"))], lambda page: page.press("End")),
    "hidden": (lambda page: page.run(HIDE, True), lambda page: page.run(HIDE, False)),
}
HIDE = """
Object.defineProperty(document, "hidden", { get: () => value, configurable: true });
document.dispatchEvent(new Event("visibilitychange"));
"""


@pytest.mark.parametrize("away", AWAY)
def test_a_play_knows_the_live_edge_however_long_its_viewer_was_away(
    page: Page, made: Path, tmp_path: Path, away: str
) -> None:
    """A play is sent a second ahead here: what has become of the stream, only reports can tell."""
    leave, come_back = AWAY[away]
    publisher = Publisher(made / "static", tmp_path / "live")
    publisher.publish(4)
    with served(tmp_path, "--max-lead-s", "1") as server:
        watch(page, f"{server.url}/watch/live", 480, 320)
        page.click("swings-player canvas")
        page.wait(f"player.shownFrame >= 15 && state.playing && !{BEHIND}")
        leave(page)
        publisher.publish(7)
        page.wait("player.numFrames === 165")
        come_back(page)
        page.wait(f"player.shownFrame >= 120 && state.playing && !{BEHIND}")
        assert "stopped" not in page.value(NOTE)


def test_a_stream_of_whole_slices_grows_too(
    page: Page, made: Path, url: str, tmp_path: Path
) -> None:
    publisher = Publisher(made / "whole", tmp_path / "live")
    publisher.publish(2)
    page.open(url, 160, 120)
    page.wait("player.shownFrame === 9 && state.waiting")
    publisher.publish(3)
    page.wait("player.shownFrame === 24 && state.waiting")
    publisher.finish()
    page.wait("player.shownFrame === 39 && !state.playing")
