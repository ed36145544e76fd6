"""The page plays a stream with and without its temporal layer, from a server and from files."""

from __future__ import annotations

from pathlib import Path

import pytest

from codec.stream import StreamReader
from codec.tools.static import export_static
from tests.support.hosted_streams import served
from tests.support.slots.slot_streams import write_busy_stream
from tests.support.slots.updates import small_layout
from tests.support.suite.once import made_once
from tests.support.web.canvas import wait_for_picture
from tests.support.web.chromium import Page
from tests.support.web.site import player_host, watch

NUM_FRAMES = 30


def make(root: Path) -> None:
    write_busy_stream(root / "s", NUM_FRAMES, small_layout(1, (40, 20), 0, 10, 2))
    export_static(root / "s", root / "static")


@pytest.mark.parametrize("host", ["server", "files"])
def test_it_shows_every_frame(
    page: Page, tmp_path_factory: pytest.TempPathFactory, tmp_path: Path, host: str
) -> None:
    root = made_once(tmp_path_factory, "web-temporal", make)
    reader = StreamReader(root / "s")
    (tmp_path / "static").symlink_to(root / "static")
    with served(root) as server, player_host(tmp_path) as files:
        pages = {
            "server": f"{server.url}/watch/s?",
            "files": f"{files}/player/watch.html?src=../static&",
        }
        watch(page, f"{pages[host]}autoplay=0")
        for frame, layers in ((0, 3), (7, 3), (8, 3), (13, 3), (12, 2), (18, 2)):
            if frame == 12:
                page.run("player.setLayers(2)")
                page.wait("state.layers === 2")
            page.run("player.seek(value)", frame)
            wait_for_picture(page, reader, frame, layers)
