"""The player on other pages: from a file, in a frame, under a strict policy, from a script."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from urllib.parse import quote

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
        assert page.value("part('.note:not(.soft)').textContent") == message


EVENTS = [
    *("loadedmetadata", "play", "playing", "waiting", "pause", "seeking", "seeked"),
    *("ratechange", "layerschange", "ended", "error"),
]
SCRIPT = """
await import("/player/player.js");
const made = document.createElement("swings-player");
window.heard = [];
for (const type of value) made.addEventListener(type, () => heard.push(type));
made.addEventListener("timeupdate", () => (heard.time = made.currentTime));
const before = [made.paused, made.currentTime, Number.isNaN(made.duration), made.view];
made.src = "/clip";
document.body.replaceChildren(made);
return before;
"""


COPY_LINK = """
const clipboard = { writeText: (text) => (window.copied = text) };
Object.defineProperty(navigator, "clipboard", { value: clipboard, configurable: true });
await element.copyLink();
return copied;
"""


def test_what_a_script_can_do(page: Page, site: Site) -> None:
    """The events and properties are those of a media element."""

    def heard() -> list[str]:
        """The events since the last call."""
        found: list[str] = page.run("return heard.splice(0)")
        return found

    page.expect("404")
    page.open(f"{site.url}/web/tsconfig.json", 160, 120)
    assert page.run(SCRIPT, EVENTS) == [True, 0, True, ""]
    page.wait("player.shownFrame === 0")
    assert heard() == ["loadedmetadata"]
    values = "[element.duration, element.numLayers, element.layers, element.view]"
    assert page.value(values) == [1.5, 3, 0, "0,0,1,0,0"]

    sought = "element.currentTime = 1; return [element.seeking, element.currentTime]"
    assert page.run(sought) == [True, 1]
    page.wait("heard.includes('seeked')")
    assert page.value("[element.seeking, player.shownFrame]") == [False, 30]
    assert heard() == ["seeking", "seeked"]

    page.run("element.playbackRate = 0.5; element.layers = 2; element.play()")
    page.wait("element.ended")
    found = [event for event in heard() if event != "waiting"]
    assert found[:4] == ["ratechange", "layerschange", "play", "playing"]
    assert found[-2:] == ["pause", "ended"]
    assert page.value("[element.paused, element.currentTime, heard.time]") == [True, 1.5, 1.5]

    page.run("element.loop = true; element.play()")
    page.wait("heard.time < 0.5")
    page.run("element.pause()")
    found = heard()
    # The stream has ended: playing starts with a seek to the first frame.
    assert (found[:2], found[-1]) == (["seeking", "play"], "pause")

    link = f"{site.url}/player/watch.html?src={quote(site.url, safe='')}%2Fclip&t="
    assert page.run(COPY_LINK).startswith(link)
    page.run("element.setAttribute('link', '/mine?id=7')")
    assert page.run(COPY_LINK).startswith(f"{site.url}/mine?id=7&t=")

    page.run("element.src = '../nothing'")
    page.wait("heard.includes('error')")
    assert heard() == ["ratechange", "error"]  # a new stream begins at the default rate
    assert "HTTP 404" in page.value("element.error.message")
    refused = "try { element.playbackRate = 0 } catch (e) { return e.name }"
    assert page.run(refused) == "RangeError"
