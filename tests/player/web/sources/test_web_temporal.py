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

    def check(frame: int, layers: int) -> None:
        page.run("player.seek(value)", frame)
        wait_for_picture(page, reader, frame, layers)

    (tmp_path / "static").symlink_to(root / "static")
    with served(root) as server, player_host(tmp_path) as files:
        url = (
            f"{server.url}/watch/s?"
            if host == "server"
            else f"{files}/player/watch.html?src=../static&"
        )
        watch(page, f"{url}autoplay=0")
        for frame in (0, 7, 8, 13):
            check(frame, 3)
        page.run("player.setLayers(2)")
        page.wait("state.layers === 2")
        for frame in (12, 18):
            check(frame, 2)
