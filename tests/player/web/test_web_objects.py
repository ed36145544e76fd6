"""Objects that a page fetches from a real server, inflated by the browser."""

from __future__ import annotations

import hashlib
import time
from pathlib import Path

from codec.stream import StreamReader
from codec.stream.segment import packet_content
from server.operate.sign.signing import Signer, add_key, read_keys
from tests.support.commands import serving
from tests.support.hosted_streams import write_stream
from tests.support.slots.slot_streams import write_busy_stream
from tests.support.slots.updates import small_layout
from tests.support.web.chromium import Page
from tests.support.web.site import watch

FETCH = """
const response = await fetch(value.url, {headers: value.headers, cache: value.cache});
const bytes = await response.arrayBuffer();
const hash = await crypto.subtle.digest("SHA-256", bytes);
const hex = [...new Uint8Array(hash)].map((one) => one.toString(16).padStart(2, "0")).join("");
return [response.status, bytes.byteLength, hex];
"""


def test_fetch_gives_what_is_in_the_packets(page: Page, tmp_path: Path) -> None:
    write_stream(tmp_path / "walk", 12)
    found = StreamReader(tmp_path / "walk").read_object(0, 1)
    inside = b"".join(
        packet_content(found.data[one.offset : one.offset + one.size], 1 << 24)
        for one in found.entries
    )
    stored = found.data
    with serving(tmp_path) as url:
        page.expect("404")  # its icon
        page.open(f"{url}/healthz", 160, 120)
        path = f"{url}/v1/streams/walk/segments/0/1"
        # Twice from the server, once from the browser's own memory.
        for cache in ("no-store", "no-cache", "default"):
            value = {"url": path, "headers": {}, "cache": cache}
            expected = [200, len(inside), hashlib.sha256(inside).hexdigest()]
            assert page.run(FETCH, value) == expected
        ranged = {"url": path, "headers": {"Range": "bytes=0-99"}, "cache": "no-store"}
        assert page.run(FETCH, ranged) == [206, 100, hashlib.sha256(stored[:100]).hexdigest()]


def test_the_page_plays_under_a_signed_url(page: Page, tmp_path: Path) -> None:
    write_busy_stream(tmp_path / "root" / "walk", 30, small_layout(1, (40, 30, 20), 0, 15))
    add_key(tmp_path / "keys")
    prefix = Signer(read_keys(tmp_path / "keys")).sign("walk", int(time.time()) + 600)
    with serving(tmp_path / "root", "--keys", tmp_path / "keys") as url:
        watch(page, f"{url}{prefix}/watch/walk", 480, 320)
        page.wait("player.shownFrame >= 20")
