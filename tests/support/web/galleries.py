"""The server's pages: the list of streams without a server, and all pages of a server."""

from __future__ import annotations

import contextlib
import json
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

from codec.stream.poster import POSTER_NAME, write_poster
from player.render.cpu import render_splats
from server.html.gallery import Card, card_html, front_page
from tests.support.hosted_streams import ring_of_cameras, served, wait_for_stream, write_stream
from tests.support.web.chromium import Page
from tests.support.web.playerstates import Screen, open_on


def write_gallery(folder: Path, count: int) -> Path:
    """Writes a list of `count` streams as N.html: long titles, short ones, and a broken stream."""
    cards = [
        Card(
            f"s{n}",
            f"Take {n} of a walk through the long hall and back again" if n % 3 else f"Take {n}",
            seconds=7.0 * n + 1,
            live=n % 20 == 5,
            about="20,000 Gaussians, 4 layers, 30 fps",
        )
        for n in range(count)
    ]
    page = front_page([*map(card_html, cards)], {"broken": "no manifest"}, "https://example.com")
    path = folder / f"{count}.html"
    path.write_text(page, encoding="utf-8")
    return path


@contextlib.contextmanager
def serving(folder: Path, count: int) -> Iterator[str]:
    """Runs a swings server with `count` streams of one scene, named s0, s1, ...; gives its URL."""
    cameras = tuple(camera.scaled(10) for camera in ring_of_cameras())
    first = write_stream(folder / "s0", 60, cameras=cameras, poster=POSTER_NAME)
    write_poster(first, render_splats)
    manifest = json.loads((first / "manifest.json").read_text())
    for n in range(count):
        stream = folder / f"s{n}"
        if n > 0:
            shutil.copytree(first, stream)
        title = "A walk through the long hall and back again, take" if n % 3 else "Take"
        text = json.dumps({**manifest, "title": f"{title} {n + 1}"})
        (stream / "manifest.json").write_text(text)
    with served(folder) as server:
        wait_for_stream(server, f"s{count - 1}")
        yield server.url


def _front(page: Page, url: str, screen: Screen) -> None:
    open_on(page, url, screen)
    page.wait("document.images[0]?.naturalWidth > 0")


def _watch(page: Page, url: str, screen: Screen) -> None:
    open_on(page, f"{url}/watch/s0?autoplay=0", screen)
    page.wait("player.shownFrame >= 0")


def _embed(page: Page, url: str, screen: Screen) -> None:
    _watch(page, url, screen)
    page.click("button[popovertarget=embed]")
    page.wait("document.querySelector('#embed').matches(':popover-open')")


PAGES: dict[str, tuple[int, Callable[[Page, str, Screen], None]]] = {
    "gallery-of-1": (1, _front),
    "gallery-of-200": (200, _front),
    "watch": (1, _watch),
    "watch-embed": (1, _embed),
}
"""Number of streams of the server, and function that opens the page."""
