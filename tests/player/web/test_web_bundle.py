"""The bundle of player/web: its contents, the requests of its page, and a play."""

from __future__ import annotations

import gzip
import json
import re
import shutil
from pathlib import Path
from urllib.parse import quote
from urllib.request import urlopen

import pytest

from codec.tools.static import write_page
from server.html.htmlpages import WatchedStream, frame_html, watch_page
from server.html.webplayer import WebPlayer
from tests.server.hostile.serverprocess import ServerProcess, server_process
from tests.support.commands import ROOT
from tests.support.hosted_streams import small_manifest, write_stream
from tests.support.waiting import wait_until
from tests.support.web.chromium import Page
from tests.support.web.nodeprocess import WEB
from tests.support.web.site import Site

MOST_REQUESTS = 10
MOST_SCRIPT_BYTES = 51_000
"""Of a first load, with the heads of the responses; `npm run size` limits the scripts alone."""

BUNDLE = WEB / "bundle"
BUILT = json.loads((BUNDLE / "manifest.json").read_text())
FIRST, HARMONICS = BUILT["first"], BUILT["harmonics"]
PRELOADS = r'modulepreload" href="\.+/(.*?)"'
LATER = {path.name for path in BUNDLE.glob("*.js")} - {*FIRST["served"]}


def test_what_a_page_begins_with_is_what_the_build_says() -> None:
    player = WebPlayer()
    assert [name.rpartition("/")[2] for name in player.modules] == FIRST["served"]
    for name in player.modules:
        asset = player.assets[name]
        assert gzip.decompress(asset.coded["gzip"]) == asset.data
    page = (BUNDLE / "watch.html").read_text(encoding="utf-8")
    assert re.findall(PRELOADS, page) == FIRST["hosted"]


def test_a_page_of_a_stream_with_many_harmonics_loads_their_code_at_once(tmp_path: Path) -> None:
    for sh_degree, count in (1, 0), (2, 1):
        watched = WatchedStream("walk", "", "", "http://127.0.0.1", 1.5, sh_degree=sh_degree)
        served = watch_page(watched, WebPlayer(), shared=False)
        (tmp_path / f"{sh_degree}").mkdir()
        write_page(tmp_path / f"{sh_degree}", small_manifest(sh_degree=sh_degree))
        exported = (tmp_path / f"{sh_degree}" / "index.html").read_text(encoding="utf-8")
        for page in str(served), exported:
            names = [Path(name).name for name in re.findall(PRELOADS, page)]
            assert names.count(HARMONICS) == count


COPIED = """
const clipboard = { writeText: (text) => (window.copied = text) };
Object.defineProperty(navigator, "clipboard", { value: clipboard, configurable: true });
element.setAttribute("link", "/mine?id=7");
await element.copyLink();
const mine = window.copied;
element.removeAttribute("link");
await element.copyLink();
return [mine, window.copied];
"""
"""Copies the link of a player whose page has an address for it, and of one whose page has none."""


def check_link(page: Page, watch_url: str) -> None:
    mine, link = page.run(COPIED)
    assert mine.startswith(page.value("location.origin + '/mine?id=7&t='"))
    source = quote(page.value("element.currentSrc"), safe="")
    assert link.startswith(f"{watch_url}?src={source}&t=")
    with urlopen(link) as response:
        assert response.status == 200


def test_links_and_embed_code_lead_to_the_page_beside_it(page: Page, site: Site) -> None:
    """The frame has the permissions of the server's page and docs/EMBED.md."""
    mine = '<script type="module" src="player/player.js"></script><swings-player src="clip">'
    page.open(site.write_page("mine.html", mine), 640, 480)
    page.wait("player.shownFrame >= 0 && part('.bar')")
    check_link(page, f"{site.url}/player/watch.html")
    page.run("part('.more').click()")
    page.wait("part('[data-name=embed]')")
    page.run("part('[data-name=embed]').click()")
    page.wait("copied.startsWith('<iframe')")
    code = page.value("copied")
    assert f'src="{site.url}/player/watch.html?src=' in code
    served = frame_html(WatchedStream("walk", "", "", "http://127.0.0.1", 1.5))
    documented = (ROOT / "docs" / "EMBED.md").read_text(encoding="utf-8")
    texts = code, served, documented
    assert len({re.findall('allow="([^"]*)"', text)[0] for text in texts}) == 1


def requests_of(server: ServerProcess) -> dict[str, list[tuple[int, int]]]:
    """Status and bytes of each response to a GET, by path without the query; not of scripts that
    the page loads after its first frame."""
    answers: dict[str, list[tuple[int, int]]] = {}
    for line in server.settled_log():
        found = re.search(r"method=GET path=(\S+) .*?status=(\d+) bytes=(\d+)", line)
        if found and Path(found[1]).name not in LATER:
            answers.setdefault(found[1], []).append((int(found[2]), int(found[3])))
    return answers


def test_a_page_of_the_server_starts_with_few_requests(page: Page, tmp_path: Path) -> None:
    root = tmp_path / "root"
    write_stream(root / "walk", 20, poster="poster.jpg")
    shutil.copy(ROOT / "docs" / "watch.jpg", root / "walk" / "poster.jpg")
    with server_process(root, tmp_path, "--log-requests", "all") as server:
        page.open(f"http://127.0.0.1:{server.port}/watch/walk?autoplay=0", 120, 200)
        page.wait("player.shownFrame >= 0")
        high = page.value("part('.poster').clientHeight / part('.frame').clientHeight")
        assert high == pytest.approx(0.75, abs=0.01)  # as high as the picture in test_web_view.py
        wait_until(lambda: "/v1/streams/walk/play" in requests_of(server))
        cold = requests_of(server)
        page.reopen()
        page.wait("player.shownFrame >= 0")
        both = requests_of(server)
        check_link(page, f"http://127.0.0.1:{server.port}/web/bundle/watch.html")
        page.close()
    assert sum(map(len, cold.values())) <= MOST_REQUESTS
    scripts = {path: found for path, found in cold.items() if path.endswith(".js")}
    assert {Path(path).name for path in scripts} == set(FIRST["served"])
    assert sum(size for found in scripts.values() for _, size in found) <= MOST_SCRIPT_BYTES
    assert all(both[path] == found for path, found in scripts.items()), "cached, and not asked for"
    plays = [path for path in cold if path.endswith("/play")]
    assert plays == ["/v1/streams/walk/play"]
    assert len(cold[plays[0]]) == 1, "the page's own request is the one that the worker reads"
