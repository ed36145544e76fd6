"""The page shows a stream's poster until the first frame is there, and works without one."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

from PIL import Image

from codec.files import write_atomic
from codec.stream import StreamReader
from codec.tools.static import export_static
from tests.support.commands import ROOT
from tests.support.hosted_streams import static_host, write_stream
from tests.support.web.chromium import Page

PLAYER = "document.querySelector('swings-player')"
POSTER = f"{PLAYER}.shadowRoot.querySelector('.poster')"
NAME = "art/still #1.jpg"


def test_a_poster_shows_until_the_first_frame_and_may_be_missing(
    page: Page, tmp_path: Path
) -> None:
    stream = write_stream(tmp_path / "stream", 10)
    manifest = replace(StreamReader(stream).manifest, poster=NAME)
    write_atomic(stream / "manifest.json", manifest.to_json())
    (stream / NAME).parent.mkdir()
    Image.new("RGB", (64, 48), (200, 40, 40)).save(stream / NAME)
    export_static(stream, tmp_path / "good")
    for name, missing in (("unplayable", "segments"), ("bare", "art")):
        shutil.copytree(tmp_path / "good", tmp_path / name)
        shutil.rmtree(tmp_path / name / missing)
    (tmp_path / "web").symlink_to(ROOT / "player" / "web")
    with static_host(tmp_path) as url:
        page.open(f"{url}/web/watch.html?src=../unplayable&autoplay=0", 320, 240)
        page.wait(f"{POSTER}?.naturalWidth === 64")
        assert (
            page.run(f"return {POSTER}.checkVisibility() && getComputedStyle({POSTER}).opacity")
            == "1"
        )
        page.open(f"{url}/web/watch.html?src=../good&autoplay=0", 320, 240)
        page.wait(f"{PLAYER}?.player?.shownFrame >= 0", 60)
        page.wait(f"getComputedStyle({POSTER}).opacity === '0'")
        assert page.run(f"return {POSTER}.naturalWidth") == 64
        page.open(f"{url}/web/watch.html?src=../bare&autoplay=0", 320, 240)
        page.wait(f"{PLAYER}?.player?.shownFrame >= 0", 60)
        page.wait(f"{POSTER}.hidden")
