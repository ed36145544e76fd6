"""The page plays a stream with and without its temporal layer, from a server and from files."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from codec.stream import StreamReader
from codec.tools.static import export_static
from player.render.cpu import render_splats
from scripts import webbundle
from tests.support.hosted_streams import served, static_host
from tests.support.slots.slot_streams import write_busy_stream
from tests.support.slots.updates import small_layout
from tests.support.web.canvas import LEAST_PSNR_DB, PIXELS, PLAYER, STATE, canvas_of, psnr_db
from tests.support.web.chromium import Page

WIDTH_PX, HEIGHT_PX, NUM_FRAMES = 320, 240, 30


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("host")
    write_busy_stream(root / "s", NUM_FRAMES, small_layout(1, (40, 20), 0, 10, 2))
    export_static(root / "s", root / "static")
    (root / "player").symlink_to(webbundle.WEB / "bundle")
    return root


def check_frame(page: Page, reader: StreamReader, frame: int, layers: int) -> None:
    """Asserts that the picture of `frame` with `layers` layers is that of the CPU renderer."""
    page.run(f"{PLAYER}.seek({frame})")
    page.wait(f"{PLAYER}.shownFrame === {frame}", 30)
    width_px, height_px = page.run(f"return [{PLAYER}.canvas.width, {PLAYER}.canvas.height]")
    camera = reader.manifest.camera().fitted(width_px, height_px)
    splats = reader.active_splats(frame, layers)
    wanted = render_splats(splats, camera, reader.manifest.near_m).clip(0, 1)
    found_db = 0.0
    for _ in range(100):
        found_db = psnr_db(canvas_of(page), wanted)
        if found_db >= LEAST_PSNR_DB:
            return
        time.sleep(0.1)
    raise AssertionError(f"frame {frame}, {layers} layers: {found_db} dB")


@pytest.mark.parametrize("host", ["server", "files"])
def test_it_shows_every_frame(page: Page, root: Path, host: str) -> None:
    reader = StreamReader(root / "s")
    with served(root) as server, static_host(root) as files:
        url = f"{server.url}/watch/s?autoplay=0"
        if host == "files":
            url = f"{files}/player/watch.html?src=../static&autoplay=0"
        page.open(url, WIDTH_PX, HEIGHT_PX, scripts=[PIXELS])
        page.wait(f"{PLAYER}?.shownFrame >= 0", 60)
        for frame in (0, 7, 8, 13):
            check_frame(page, reader, frame, 3)
        page.run(f"{PLAYER}.setLayers(2)")
        page.wait(f"{STATE}.layers === 2", 30)
        for frame in (12, 18):
            check_frame(page, reader, frame, 2)
        assert not page.complaints
