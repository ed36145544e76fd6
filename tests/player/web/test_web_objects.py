"""A page that plays what a real server sends under a signed URL."""

from __future__ import annotations

import time
from pathlib import Path

from server.operate.sign.signing import Signer, add_key, read_keys
from tests.support.commands import serving
from tests.support.slots.slot_streams import write_busy_stream
from tests.support.slots.updates import small_layout
from tests.support.web.chromium import Page
from tests.support.web.site import watch


def test_the_page_plays_under_a_signed_url(page: Page, tmp_path: Path) -> None:
    write_busy_stream(tmp_path / "root" / "walk", 30, small_layout(1, (40, 30, 20), 0, 15))
    add_key(tmp_path / "keys")
    prefix = Signer(read_keys(tmp_path / "keys")).sign("walk", int(time.time()) + 600)
    with serving(tmp_path / "root", "--keys", tmp_path / "keys") as url:
        watch(page, f"{url}{prefix}/watch/walk", 480, 320)
        page.wait("player.shownFrame >= 20")
