"""The player on other pages: from a file, in a frame, under a strict policy."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.commands import ROOT
from tests.support.hosted_streams import static_host
from tests.support.web.chromium import Page
from tests.support.web.site import Site, player_host

EXAMPLE = ROOT / "examples" / "embed.html"
EXAMPLE_HOST = "https://streams.example.com"
ICON = '<!doctype html><link rel="icon" href="data:," />'


@pytest.fixture
def open_host(site: Site) -> Iterator[str]:
    """A host of the player and the streams that pages of other origins may read."""
    with player_host(site.folder, cors=True) as url:
        yield url


def test_the_example_plays_from_a_file(page: Page, open_host: str, tmp_path: Path) -> None:
    text = EXAMPLE.read_text(encoding="utf-8")
    assert text.count(EXAMPLE_HOST) >= 3
    text = text.replace(f"{EXAMPLE_HOST}/stream", f"{open_host}/long")
    text = text.replace(EXAMPLE_HOST, open_host)
    (tmp_path / "embed.html").write_text(text, encoding="utf-8")
    page.open((tmp_path / "embed.html").as_uri(), 480, 400)
    page.wait("player.shownFrame >= 0")
    page.click("#toggle")
    page.wait("element.currentTime > 0.2")
    page.wait("document.querySelector('#time').textContent.endsWith(' of 20.0 s')")
    assert page.value("document.querySelector('#toggle').textContent") == "Pause"
    page.click("#toggle")
    page.wait("element.paused")
    page.click("#again")
    page.wait("player.shownFrame === 0")


def test_a_frame_of_another_origin_with_a_stream_of_a_third(
    page: Page, site: Site, open_host: str, tmp_path: Path
) -> None:
    source = f"{site.url}/player/watch.html?src={open_host}/clip&autoplay=1&loop=0&t=0.5"
    frame = f'<iframe src="{source}" allow="fullscreen; xr-spatial-tracking"></iframe>'
    (tmp_path / "mine.html").write_text(ICON + frame)
    with static_host(tmp_path) as mine:
        page.open(f"{mine}/mine.html")
        page.enter("watch.html")
        page.wait("element.ended")


def test_under_a_strict_policy(page: Page, open_host: str, tmp_path: Path) -> None:
    """The policy in docs/EMBED.md is sufficient, and the styles apply."""
    text = (ROOT / "docs" / "EMBED.md").read_text(encoding="utf-8")
    policy = text.partition("Content-Security-Policy: ")[2].partition("\n")[0]
    assert EXAMPLE_HOST in policy
    # The browser is driven from the surrounding page, because the policy forbids that, too.
    (tmp_path / "around.html").write_text(f'{ICON}<iframe src="mine.html"></iframe>')
    (tmp_path / "mine.html").write_text(
        '<!doctype html><meta http-equiv="Content-Security-Policy" '
        f'content="{policy.replace(EXAMPLE_HOST, open_host)}" />'
        f'<script type="module" src="{open_host}/player/player.js"></script>'
        f'<swings-player src="{open_host}/clip" autoplay></swings-player>'
    )
    with static_host(tmp_path) as mine:
        page.open(f"{mine}/around.html", 320, 240)
        inside = "frames[0].document.querySelector('swings-player')"
        page.wait(f"{inside}.ended")
        assert page.value(f"getComputedStyle({inside}).position") == "relative"


def test_a_host_that_lets_nobody_else_read(page: Page, site: Site) -> None:
    page.expect("blocked by CORS policy", "net::ERR_FAILED")
    with static_host(site.folder) as streams:
        page.open(f"{site.url}/player/watch.html?src={streams}/clip")
        page.wait("element.error")
        message = page.value("element.error.message")
        assert message.startswith(f"{streams} answers, but does not let pages of other hosts read")
        assert "Access-Control-Allow-Origin" in message
        page.wait("part('.note:not(.soft)')?.textContent === element.error.message")
