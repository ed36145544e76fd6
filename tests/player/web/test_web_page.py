"""The page plays a stream of a plain file server, as a person would have it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from codec.tools.static import export_static
from tests.support.hosted_streams import static_host
from tests.support.slots.slot_streams import write_busy_stream
from tests.support.slots.updates import small_layout
from tests.support.web.chromium import Page

ROOT = Path(__file__).parents[3]
NUM_FRAMES = 60
STATE = "document.querySelector('swings-player').player.state"
PLAYER = "document.querySelector('swings-player').player"


@pytest.fixture
def watched(page: Page, tmp_path: Path) -> Iterator[Page]:
    """The page, paused at the first frame."""
    layout = small_layout(1, (400, 300, 300), 0, 15)
    write_busy_stream(tmp_path / "stream", NUM_FRAMES, layout)
    export_static(tmp_path / "stream", tmp_path / "static")
    (tmp_path / "web").symlink_to(ROOT / "player" / "web")
    with static_host(tmp_path) as url:
        page.open(f"{url}/web/watch.html?src=../static&autoplay=0", 480, 320)
        page.wait(f"{PLAYER}?.shownFrame >= 0", 60)
        yield page
        assert not page.complaints


def test_it_plays_pauses_seeks_and_ends(watched: Page, tmp_path: Path) -> None:
    assert watched.run(f"return {STATE}.playing") is False
    watched.run("document.querySelector('swings-player').focus()")
    watched.click("swings-player .play")
    watched.wait(f"{STATE}.frame >= 5", 60)
    watched.press("k")
    watched.wait(f"{STATE}.playing === false")
    watched.press("Home")
    watched.wait(f"{PLAYER}.shownFrame === 0", 30)
    watched.press("ArrowRight")
    watched.wait(f"{PLAYER}.shownFrame === 30", 30)
    watched.screenshot(tmp_path / "page.png")
    watched.press("l")
    watched.press("End")
    watched.wait(f"{PLAYER}.shownFrame === {NUM_FRAMES - 1}", 30)
    watched.press("k")
    watched.wait(f"{PLAYER}.shownFrame < 30 && {STATE}.playing", 30)
