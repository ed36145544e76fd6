"""The server's list of streams, without a server."""

from __future__ import annotations

from pathlib import Path

from server.html.gallery import Card, card_html, front_page
from tests.support.web.chromium import Page
from tests.support.web.playerstates import Screen


def write_gallery(folder: Path, count: int) -> Path:
    """The list of `count` streams as N.html: long titles, short ones, and one that is broken."""
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


def open_page(page: Page, url: str, screen: Screen) -> None:
    options: dict[str, object] = {"deviceScaleFactor": screen.scale, "isMobile": screen.touch}
    page.open(url, screen.width_px, screen.height_px, screen.touch, (), options)
