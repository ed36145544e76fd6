"""Live streams in the browser: joining, growth and end."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from codec.tools.static import export_static
from tests.support.commands import ROOT
from tests.support.hosted_streams import static_host, write_stream
from tests.support.slots.slot_streams import write_busy_stream
from tests.support.slots.updates import small_layout
from tests.support.web.chromium import Page
from tests.support.web.publisher import Publisher

ELEMENT = "document.querySelector('swings-player')"
PLAYER = f"{ELEMENT}.player"
STATE = f"{PLAYER}.state"
BADGE = f"{ELEMENT}.shadowRoot.querySelector('.badge')"
NOTE = f"{ELEMENT}.shadowRoot.querySelector('.note.soft').textContent"
NUM_FRAMES = 300
SEGMENT_FRAMES = 15


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished export of 10 s, in segments of half a second."""
    folder = tmp_path_factory.mktemp("live")
    layout = small_layout(1, (40, 20), 0, SEGMENT_FRAMES)
    write_busy_stream(folder / "stream", NUM_FRAMES, layout)
    export_static(folder / "stream", folder / "static")
    return folder / "static"


@pytest.fixture
def publisher(made: Path, tmp_path: Path) -> Publisher:
    (tmp_path / "web").symlink_to(ROOT / "player" / "web")
    return Publisher(made, tmp_path / "live")


@pytest.fixture
def url(publisher: Publisher, tmp_path: Path) -> Iterator[str]:
    with static_host(tmp_path) as host:
        yield f"{host}/web/watch.html?src=../live&loop=0"


def watch_frames(page: Page) -> None:
    """Records every shown frame from now on."""
    page.run(f"""
        const player = {PLAYER};
        window.frames_shown = [];
        const note = () => {{
            if (frames_shown.at(-1) !== player.shownFrame) frames_shown.push(player.shownFrame);
            requestAnimationFrame(note);
        }};
        note();
    """)


def test_a_stream_that_grows_plays_at_its_edge_until_it_ends(
    page: Page, publisher: Publisher, url: str, tmp_path: Path
) -> None:
    publisher.publish(8)
    page.open(url, 480, 320)
    page.wait(f"{PLAYER}?.shownFrame >= 0", 60)
    assert page.run(f"return {PLAYER}.shownFrame") >= 75  # 120 less 45
    watch_frames(page)
    page.wait(f"{BADGE}.classList.contains('on')")
    assert not page.run(f"return {BADGE}.classList.contains('behind')")
    with publisher.running(0.5):
        page.wait(f"{PLAYER}.shownFrame >= 135 && {PLAYER}.numFrames >= 180", 60)
        page.screenshot(tmp_path / "live.png")
        frames = page.run("return frames_shown")
        assert frames == sorted(frames)
        scrub = f"{ELEMENT}.shadowRoot.querySelector('.scrub')"
        page.wait(f"Number({scrub}.max) >= 179 && {scrub}.value >= 135")
        page.run(f"{ELEMENT}.focus()")
        page.click("swings-player canvas")
        for way in ("badge", "key"):
            if page.run(f"return {STATE}.playing"):
                page.press("k")
            page.press("Home")
            page.wait(f"{PLAYER}.shownFrame === 0 && {BADGE}.classList.contains('behind')", 30)
            page.screenshot(tmp_path / "behind.png")
            if way == "badge":
                page.click("swings-player .badge")
            else:
                page.press("End")
            page.wait(f"{PLAYER}.shownFrame >= 135 && {STATE}.playing", 30)
            page.wait(f"!{BADGE}.classList.contains('behind')")
        watch_frames(page)
    publisher.finish()
    page.run(f"{PLAYER}.setRate(4)")
    page.wait(f"!{PLAYER}.live && !{BADGE}.classList.contains('on')", 30)
    page.wait(f"{PLAYER}.shownFrame === {NUM_FRAMES - 1} && !{STATE}.playing", 60)
    frames = page.run("return frames_shown")
    assert frames == sorted(frames)
    assert not page.complaints


def test_a_stream_is_waited_for_before_it_begins_and_while_there_is_no_network(
    page: Page, publisher: Publisher, url: str
) -> None:
    page.open(url, 320, 240)
    page.wait(f"({NOTE} ?? '').includes('has no frames yet')", 30)
    publisher.publish(3)
    page.wait(f"{PLAYER}.shownFrame >= 0 && {NOTE} === ''", 60)
    watch_frames(page)
    page.set_offline(True)
    publisher.publish(4)
    # It shows the data that it had, and waits.
    page.wait(f"{STATE}.waiting && {NOTE}.includes('trying again')", 30)
    assert page.run(f"return {PLAYER}.numFrames") == 45
    page.set_offline(False)
    page.wait(f"{PLAYER}.numFrames === 105 && {PLAYER}.shownFrame > 60 && {NOTE} === ''", 30)
    page.set_offline(True)
    publisher.finish()
    page.set_offline(False)
    page.wait(f"!{PLAYER}.live && {PLAYER}.numFrames === {NUM_FRAMES}", 30)
    page.wait(f"{PLAYER}.shownFrame > 110", 30)
    frames = page.run("return frames_shown")
    assert frames == sorted(frames)


@pytest.mark.parametrize(("query", "first"), [("&t=1", 30), ("&t=0", 0)])
def test_a_start_that_is_asked_for_is_where_it_starts(
    page: Page, publisher: Publisher, url: str, query: str, first: int
) -> None:
    publisher.publish(12)
    page.open(f"{url}&autoplay=0{query}", 320, 240)
    page.wait(f"{PLAYER}?.shownFrame === {first}", 60)
    page.wait(f"{BADGE}.classList.contains('behind')" if first == 0 else f"{BADGE}.matches('.on')")


@pytest.mark.slow
def test_a_stream_of_version_1_grows_too(page: Page, tmp_path: Path) -> None:
    write_stream(tmp_path / "stream", 40)
    export_static(tmp_path / "stream", tmp_path / "static")
    (tmp_path / "web").symlink_to(ROOT / "player" / "web")
    publisher = Publisher(tmp_path / "static", tmp_path / "live")
    publisher.publish(2)
    with static_host(tmp_path) as host:
        page.open(f"{host}/web/watch.html?src=../live&loop=0", 320, 240)
        page.wait(f"{PLAYER}?.shownFrame === 9 && {STATE}.waiting", 60)
        publisher.publish(3)
        page.wait(f"{PLAYER}.shownFrame === 24 && {STATE}.waiting", 30)
        publisher.finish()
        page.wait(f"{PLAYER}.shownFrame === 39 && !{STATE}.playing", 30)
