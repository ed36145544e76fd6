"""The player on other pages: from a file, in a frame, under a strict policy, from a script."""

from __future__ import annotations

from pathlib import Path
from urllib.parse import quote

import pytest

from codec.tools.static import export_static
from tests.support.hosted_streams import static_host
from tests.support.slots.slot_streams import write_busy_stream
from tests.support.slots.updates import small_layout
from tests.support.web.chromium import Page

ROOT = Path(__file__).parents[3]
EXAMPLE = ROOT / "examples" / "embed.html"
EXAMPLE_HOST = "https://streams.example.com"
NUM_FRAMES = 45
PLAYER = "document.querySelector('swings-player')"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a host of streams: the player in web/, a stream of 1.5 s in stream/."""
    path = tmp_path_factory.mktemp("host")
    write_busy_stream(path / "trained", NUM_FRAMES, small_layout(1, (40, 30, 20), 0, 15))
    export_static(path / "trained", path / "stream")
    (path / "web").symlink_to(ROOT / "player" / "web")
    return path


def test_the_example_plays_from_a_file(page: Page, folder: Path, tmp_path: Path) -> None:
    with static_host(folder, cors=True) as url:
        text = EXAMPLE.read_text(encoding="utf-8")
        assert text.count(EXAMPLE_HOST) >= 3
        (tmp_path / "embed.html").write_text(text.replace(EXAMPLE_HOST, url), encoding="utf-8")
        page.open((tmp_path / "embed.html").as_uri(), 760, 700)
        page.wait(f"{PLAYER}.player?.shownFrame >= 0", 60)
        page.click("#toggle")
        page.wait(f"{PLAYER}.currentTime > 0.2", 60)
        page.wait("document.querySelector('#time').textContent.endsWith(' of 1.5 s')")
        assert page.run("return document.querySelector('#toggle').textContent") == "Pause"
        page.click("#toggle")
        page.wait(f"{PLAYER}.paused")
        page.screenshot(tmp_path / "embed.png")
        page.click("#again")
        page.wait(f"{PLAYER}.player.shownFrame === 0", 30)
        assert not page.complaints


def test_a_frame_of_another_origin_with_a_stream_of_a_third(
    page: Page, folder: Path, tmp_path: Path
) -> None:
    with (
        static_host(folder, cors=True) as streams,
        static_host(folder) as host,
        static_host(tmp_path) as mine,
    ):
        source = f"{host}/web/watch.html?src={streams}/stream&autoplay=1&loop=0&t=0.5"
        frame = f'<iframe src="{source}" allow="fullscreen; xr-spatial-tracking"></iframe>'
        (tmp_path / "mine.html").write_text(
            '<!doctype html><link rel="icon" href="data:," />' + frame
        )
        page.open(f"{mine}/mine.html")
        page.enter("watch.html")
        page.wait(f"{PLAYER}?.ended", 60)
        assert not page.complaints


def test_under_a_strict_policy(page: Page, folder: Path, tmp_path: Path) -> None:
    """The policy in docs/EMBED.md is sufficient, and the styles apply."""
    with static_host(folder, cors=True) as host, static_host(tmp_path) as mine:
        text = (ROOT / "docs" / "EMBED.md").read_text(encoding="utf-8")
        policy = text.partition("Content-Security-Policy: ")[2].partition("\n")[0]
        assert EXAMPLE_HOST in policy
        # The browser is driven from the surrounding page, because the policy forbids that, too.
        (tmp_path / "around.html").write_text(
            '<!doctype html><link rel="icon" href="data:," /><iframe src="mine.html"></iframe>'
        )
        (tmp_path / "mine.html").write_text(
            '<!doctype html><meta http-equiv="Content-Security-Policy" '
            f'content="{policy.replace(EXAMPLE_HOST, host)}" />'
            f'<script type="module" src="{host}/web/element/swingsplayer.js"></script>'
            f'<swings-player src="{host}/stream" autoplay></swings-player>'
        )
        page.open(f"{mine}/around.html")
        player = PLAYER.replace("document", "frames[0].document")
        page.wait(f"{player}?.ended", 60)
        assert page.run(f"return getComputedStyle({player}).position") == "relative"
        assert not page.complaints


def test_a_host_that_lets_nobody_else_read(page: Page, folder: Path, tmp_path: Path) -> None:
    with static_host(folder) as streams, static_host(folder) as host:
        page.open(f"{host}/web/watch.html?src={streams}/stream")
        page.wait(f"{PLAYER}?.error", 30)
        message = page.run(f"return {PLAYER}.error.message")
        assert message.startswith(f"{streams} answers, but does not let pages of other hosts read")
        assert "Access-Control-Allow-Origin" in message
        note = f"{PLAYER}.shadowRoot.querySelector('.note:not(.soft)').textContent"
        assert page.run(f"return {note}") == message


EVENTS = [
    *("loadedmetadata", "play", "playing", "waiting", "pause", "seeking", "seeked"),
    *("ratechange", "layerschange", "ended", "error"),
]
SCRIPT = """
await import(value.url + "/web/element/swingsplayer.js");
const player = document.createElement("swings-player");
window.heard = [];
for (const type of value.events) player.addEventListener(type, () => heard.push(type));
player.addEventListener("timeupdate", () => (heard.time = player.currentTime));
const before = [player.paused, player.currentTime, Number.isNaN(player.duration), player.view];
player.src = value.url + "/stream";
document.body.replaceChildren(player);
return before;
"""


COPY_LINK = f"""
const clipboard = {{ writeText: (text) => (window.copied = text) }};
Object.defineProperty(navigator, "clipboard", {{ value: clipboard, configurable: true }});
await {PLAYER}.copyLink();
return copied;
"""


def test_what_a_script_can_do(page: Page, folder: Path) -> None:
    """The events and properties are those of a media element."""

    def heard() -> list[str]:
        """The events since the last call."""
        found: list[str] = page.run("return heard.splice(0)")
        return found

    with static_host(folder) as url:
        page.open(f"{url}/web/tsconfig.json", 480, 320)
        before = page.run(SCRIPT, {"url": url, "events": EVENTS})
        assert before == [True, 0, True, ""]
        page.wait(f"{PLAYER}.player.shownFrame === 0", 30)
        assert heard() == ["loadedmetadata"]
        values = f"return [{PLAYER}.duration, {PLAYER}.numLayers, {PLAYER}.layers, {PLAYER}.view]"
        assert page.run(values) == [1.5, 3, 0, "0,0,1,0,0"]

        sought = f"{PLAYER}.currentTime = 1; return [{PLAYER}.seeking, {PLAYER}.currentTime]"
        assert page.run(sought) == [True, 1]
        page.wait("heard.includes('seeked')")
        assert page.run(f"return [{PLAYER}.seeking, {PLAYER}.player.shownFrame]") == [False, 30]
        assert heard() == ["seeking", "seeked"]

        page.run(f"{PLAYER}.playbackRate = 0.5; {PLAYER}.layers = 2; {PLAYER}.play()")
        page.wait(f"{PLAYER}.ended", 30)
        found = [event for event in heard() if event != "waiting"]
        assert found[:4] == ["ratechange", "layerschange", "play", "playing"]
        assert found[-2:] == ["pause", "ended"]
        assert page.run(f"return [{PLAYER}.paused, {PLAYER}.currentTime]") == [True, 1.5]
        assert page.run("return heard.time") == 1.5

        page.run(f"{PLAYER}.loop = true; {PLAYER}.play()")
        page.wait("heard.time < 0.5", 30)
        page.run(f"{PLAYER}.pause()")
        found = heard()
        # The stream has ended: playing starts with a seek to the first frame.
        assert (found[:2], found[-1]) == (["seeking", "play"], "pause")

        assert page.run(COPY_LINK).startswith(
            f"{url}/web/watch.html?src={quote(url, safe='')}%2Fstream&t="
        )
        page.run(f"{PLAYER}.setAttribute('link', '/mine?id=7')")
        assert page.run(COPY_LINK).startswith(f"{url}/mine?id=7&t=")

        page.run(f"{PLAYER}.src = '../nothing'")
        page.wait("heard.includes('error')", 30)
        assert heard() == ["ratechange", "error"]  # a new stream begins at the default rate
        assert "HTTP 404" in page.run(f"return {PLAYER}.error.message")
        assert page.run(f"try {{ {PLAYER}.playbackRate = 0 }} catch (e) {{ return e.name }}") == (
            "RangeError"
        )
