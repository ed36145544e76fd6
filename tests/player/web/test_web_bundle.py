"""The bundle of player/web: what it is made of, what a page of it loads, and that it plays."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from codec.tools.static import export_static
from scripts import webbundle
from tests.server.hostile.serverprocess import ServerProcess, server_process
from tests.support.hosted_streams import static_host, write_stream
from tests.support.web.chromium import Page

PLAYER = "document.querySelector('swings-player')?.player"
MOST_REQUESTS = 8
MOST_SCRIPT_BYTES = 61_000


def test_it_is_what_the_sources_give() -> None:
    if not webbundle.ESBUILD.exists():
        pytest.skip("needs npm: apt-get install npm, then scripts/setup dev")
    folder = webbundle.WEB / "bundle"
    committed = {path.name: path.read_text(encoding="utf-8") for path in folder.iterdir()}
    fresh = webbundle.bundle()
    assert committed.keys() == fresh.keys()
    changed = [name for name in fresh if fresh[name] != committed[name]]
    assert not changed, "the sources have changed; run scripts/webbundle"


def test_it_plays_from_a_plain_file_server(page: Page, tmp_path: Path) -> None:
    write_stream(tmp_path / "stream", 20)
    export_static(tmp_path / "stream", tmp_path / "static")
    (tmp_path / "player").symlink_to(webbundle.WEB / "bundle")
    with static_host(tmp_path) as url:
        page.open(f"{url}/player/watch.html?src=../static&t=0.5&autoplay=0", 320, 240)
        page.wait(f"{PLAYER}?.shownFrame === 15", 60)
        assert not page.complaints


def requests_of(server: ServerProcess) -> dict[str, list[tuple[int, int]]]:
    """By path without its query the status and bytes of each answer to a GET."""
    answers: dict[str, list[tuple[int, int]]] = {}
    for line in server.settled_log(0):
        found = re.search(r"method=GET path=(\S+) .*?status=(\d+) bytes=(\d+)", line)
        if found:
            answers.setdefault(found[1], []).append((int(found[2]), int(found[3])))
    return answers


def test_a_page_of_the_server_starts_with_few_requests(page: Page, tmp_path: Path) -> None:
    root = tmp_path / "root"
    write_stream(root / "walk", 20, poster="poster.jpg")
    (root / "walk" / "poster.jpg").write_bytes(
        (Path(__file__).parents[3] / "docs/watch.jpg").read_bytes()
    )
    with server_process(root, tmp_path) as server:
        page.open(f"http://127.0.0.1:{server.port}/watch/walk?autoplay=0", 320, 240)
        page.wait(f"{PLAYER}?.shownFrame >= 0", 60)
        cold = requests_of(server)
        page.reopen()
        page.wait(f"{PLAYER}?.shownFrame >= 0", 60)
        both = requests_of(server)
        assert not page.complaints
        page.close()
    assert sum(map(len, cold.values())) <= MOST_REQUESTS
    scripts = {path: found for path, found in cold.items() if path.endswith(".js")}
    assert len(scripts) == 3
    assert sum(size for found in scripts.values() for _, size in found) <= MOST_SCRIPT_BYTES
    assert all(both[path] == found for path, found in scripts.items()), "cached, and not asked for"
    plays = [path for path in cold if path.endswith("/play")]
    assert plays == ["/v1/streams/walk/play"]
    assert len(cold[plays[0]]) == 1, "the page's own request is the one that the worker reads"
