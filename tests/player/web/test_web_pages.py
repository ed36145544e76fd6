"""The pages of the server in Chromium: accessible by axe-core, searched, sorted, framed."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from server.html.htmlpages import MANY, Card, card_html, front_page
from tests.support.hosted_streams import (
    ServerProcess,
    served,
    static_host,
    wait_for_stream,
    write_stream,
)
from tests.support.web.chromium import Page
from tests.support.web.playerstates import SCREENS, Screen, open_on

NUM_STREAMS = 12


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServerProcess]:
    """A server with twelve streams, number n of n + 1 seconds, and a broken stream."""
    root = tmp_path_factory.mktemp("root")
    for n in range(NUM_STREAMS):
        write_stream(root / f"s{n}", 2 * n + 2, slice_size=8, fps=2, title=f"Take {n} of the walk")
    (root / "broken").mkdir()
    (root / "broken" / "manifest.json").write_text("{}")
    with served(root) as running:
        wait_for_stream(running, f"s{NUM_STREAMS - 1}")
        yield running


def gallery(count: int) -> str:
    """A list of `count` streams: long titles, short ones, and a broken stream."""
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
    return front_page([*map(card_html, cards)], {"broken": "no manifest"}, "https://example.com")


@pytest.mark.parametrize("screen", SCREENS, ids=lambda screen: screen.name)
def test_a_gallery_of_any_size_fits(page: Page, tmp_path: Path, screen: Screen) -> None:
    find = "document.querySelector('input[type=search]')?.checkVisibility() ?? false"
    with static_host(tmp_path) as url:
        for count in (1, 200):
            (tmp_path / f"{count}.html").write_text(gallery(count), encoding="utf-8")
            open_on(page, f"{url}/{count}.html", screen)
            if count == 1 or screen.touch:
                assert page.axe() == []
            assert page.value("document.documentElement.scrollWidth <= innerWidth")
            assert len(shown(page)) == count
            assert page.value(find) is (count >= MANY)


def shown(page: Page) -> list[str]:
    cards = "[...document.querySelectorAll('li:not([hidden]) .title')]"
    titles: list[str] = page.value(f"{cards}.map((one) => one.textContent)")
    return titles


CHOOSE = """
const [box, select] = document.querySelectorAll("input, select");
[box.value, select.value] = value;
box.dispatchEvent(new Event("input"));
select.dispatchEvent(new Event("change"));
"""


def test_cards_are_found_and_sorted(page: Page, server: ServerProcess) -> None:
    page.open(server.url, 900, 700)
    titles = [f"Take {n} of the walk" for n in range(NUM_STREAMS)]
    assert shown(page) == titles
    assert page.axe() == []
    page.run(CHOOSE, ["walk 7", "title"])
    assert shown(page) == [titles[7]]
    assert page.value("document.querySelector('output').textContent") == "1 of 12 streams"
    page.run(CHOOSE, ["", "longest"])
    assert shown(page) == titles[::-1]
    page.click("summary")
    assert page.axe() == []


def test_the_page_of_a_stream(page: Page, server: ServerProcess) -> None:
    address = f"{server.url}/watch/s3?autoplay=0"
    page.open(address, 390, 844, touch=True)
    page.wait("player.shownFrame >= 0 && part('.share').checkVisibility()")
    assert page.axe() == []
    assert page.value("[element.clientWidth, element.clientHeight]") == [390, 844]
    page.click("header a")
    page.wait("location.pathname === '/'")
    page.open(address, 1000, 700)
    links = "[document.querySelector('footer a').href, element.getAttribute('download')]"
    assert (
        page.value(f"{links}.map((link) => new URL(link, document.baseURI).pathname)")
        == ["/v1/streams/s3/stream.swings"] * 2
    )
    page.click("button[popovertarget=embed]")
    page.wait("document.querySelector('#embed').matches(':popover-open')")
    assert page.axe() == []


def test_in_a_frame_the_player_is_alone(page: Page, server: ServerProcess) -> None:
    page.expect("404")  # its icon
    page.open(f"{server.url}/healthz", 640, 480)
    page.run(
        """document.body.innerHTML = '<iframe width=320 height=180 src="/watch/s3?autoplay=0">';"""
    )
    page.enter("/watch/")
    page.wait("player.shownFrame >= 0")
    size = "element.getBoundingClientRect()"
    assert page.value(f"[{size}.width, {size}.height, {size}.top]") == [320, 180, 0]
    assert page.value("document.querySelector('header').checkVisibility()") is False
