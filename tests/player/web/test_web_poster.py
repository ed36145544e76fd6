"""The page shows a stream's poster until the first frame is there, and works without one."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

from PIL import Image

from codec.files import write_atomic
from codec.stream import StreamReader
from codec.tools.static import export_static
from tests.support.hosted_streams import write_stream
from tests.support.web.chromium import Page
from tests.support.web.site import player_host, watch

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
    page.expect("404")
    opacity = "getComputedStyle(part('.poster')).opacity"
    with player_host(tmp_path) as url:
        address = f"{url}/player/watch.html?autoplay=0&src=.."
        page.open(f"{address}/unplayable")
        page.wait("part('.poster').naturalWidth === 64")
        assert page.value(f"part('.poster').checkVisibility() && {opacity}") == "1"
        watch(page, f"{address}/good")
        page.wait(f"{opacity} === '0'")
        assert page.value("part('.poster').naturalWidth") == 64
        watch(page, f"{address}/bare")
        page.wait("part('.poster').hidden")
