"""The browser player refuses a stream whose manifest claims 2^24 Gaussians, unless that is
allowed."""

from __future__ import annotations

from pathlib import Path
from urllib.parse import quote

from tests.support.slots.many import NUM_GAUSSIANS, write_many
from tests.support.web.chromium import Page
from tests.support.web.site import player_host


def test_the_page_says_so_and_its_address_allows_more(page: Page, tmp_path: Path) -> None:
    write_many(tmp_path / "many")
    with player_host(tmp_path) as host:
        address = f"{host}/player/watch.html?src={quote(f'{host}/many')}"
        page.open(address, 160, 120)
        page.wait("element.error")
        told = page.value("element.error.message")
        assert "has 16,777,216 Gaussians; max-gaussians=16777216" in told
        # If allowed, it fails at the next step: the device's textures, or objects without gzip.
        page.open(f"{address}&max-gaussians={NUM_GAUSSIANS}&autoplay=0", 160, 120)
        page.wait("element.error")
        told = page.value("element.error.message")
        assert "need a texture" in told or "export --static" in told
