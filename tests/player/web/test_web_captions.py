"""Captions in the page: reading files, and text over the picture."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from codec.stream.captions import Captions
from codec.tools.static import export_static
from codec.tracks.streamtracks import add_captions
from tests.codec.tracks.test_streamsound import VTT
from tests.support.hosted_streams import write_stream
from tests.support.sounding import add_clicks
from tests.support.web.chromium import Page
from tests.support.web.site import player_host, watch

SHOWN = "part('.captions').textContent"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("captions")
    stream = write_stream(folder / "trained", 90)
    export_static(stream, folder / "bare")
    add_clicks(stream, (0, 45))
    (folder / "in.vtt").write_text(VTT)
    (folder / "de.vtt").write_text(VTT.replace("Two", "Zwei"))
    add_captions(stream, folder / "in.vtt", Captions("en", "English"))
    add_captions(stream, folder / "de.vtt", Captions("de", "Deutsch"))
    export_static(stream, folder / "static")
    return folder


@pytest.fixture(scope="module")
def url(folder: Path) -> Iterator[str]:
    with player_host(folder) as url:
        yield url


def opened(page: Page, url: str, name: str) -> None:
    watch(page, f"{url}/player/watch.html?src=../{name}&autoplay=0", 640, 360)


def test_they_show_in_the_language_that_a_viewer_chooses(page: Page, url: str) -> None:
    opened(page, url, "static&t=1.5")
    page.wait("part('.cc').checkVisibility()")
    assert page.value(SHOWN) == ""
    page.run("part('.cc').click()")
    page.wait(f"{SHOWN} === '- Two\\n- lines'")
    assert page.value("part('.cc').getAttribute('aria-label')") == "Captions: English"
    assert page.axe("swings-player") == []
    page.run("element.focus()")
    page.press("c")
    page.wait(f"{SHOWN} === '- Zwei\\n- lines'")
    assert page.value("part('.captions').lang") == "de"
    page.run("element.currentTime = 0.75")
    page.wait(f"{SHOWN} === 'Good day & night\\n- Zwei\\n- lines'")
    page.run("element.currentTime = 2.5")
    page.wait(f"{SHOWN} === ''")
    page.press("c")
    page.wait("part('.cc').getAttribute('aria-pressed') === 'false'")
    page.run("element.currentTime = 0.75")
    page.wait("!element.seeking && player.shownFrame === 23")
    assert page.value(SHOWN) == ""


def test_the_language_stays_for_the_next_stream_and_one_without_has_no_button(
    page: Page, url: str
) -> None:
    page.expect("404")
    opened(page, url, "static&t=1.5")
    page.wait("part('.cc').checkVisibility()")
    page.run("part('.cc').click()")
    page.wait(f"{SHOWN} !== ''")
    page.run("element.src = '../missing'; await null")
    assert page.value(SHOWN) == "", "nothing of a stream that is closed"
    assert page.value("part('.cc').checkVisibility()") is False
    page.run("element.src = '../bare'")
    page.wait("player.manifest && player.shownFrame >= 0 && part('.bar')")
    page.wait("!part('.cc').checkVisibility()")
    assert page.value(SHOWN) == ""
    page.run("element.src = '../static'")
    page.wait(f"{SHOWN} !== ''")


CHROME = """
await import("/npm/media-chrome/dist/index.js");
document.body.innerHTML = `<media-controller>
  <swings-player slot="media" src="../static" start="1.5"></swings-player>
  <media-captions-button></media-captions-button>
</media-controller>`;
"""
MODES = "[...element.textTracks].map(({ mode, language }) => `${language} ${mode}`).join()"


def test_other_controls_and_scripts_show_them(page: Page, url: str) -> None:
    opened(page, url, "bare")
    page.run(CHROME)
    page.wait("player?.shownFrame === 45 && element.textTracks.length === 2")
    page.run("document.querySelector('media-captions-button').click()")
    page.wait(f"{SHOWN} === '- Two\\n- lines' && {MODES} === 'en showing,de disabled'")
    assert page.value("[...element.textTracks[0].cues].at(-1).text") == "- Two\n- lines"
    page.run("element.textTracks[1].mode = 'showing'")
    page.wait(f"{SHOWN} === '- Zwei\\n- lines' && {MODES} === 'en disabled,de showing'")
    page.run("part('.cc').click(); element.textTracks[0].mode = 'hidden'")
    page.wait(f"{SHOWN} === '' && {MODES} === 'en hidden,de disabled'")
    page.run("element.src = '../bare'")
    page.wait("element.textTracks.length === 0")


def test_named_characters_are_those_of_browsers(page: Page, url: str, folder: Path) -> None:
    path = folder / "static" / "captions-de.vtt"
    written = path.read_text()
    path.write_text("WEBVTT\n\n00:00.000 --> 00:03.000\ncaf&eacute; &hellip;&nosuch; <b>b</b>\n")
    opened(page, url, "static&t=1.5")
    page.wait("part('.cc').checkVisibility()")
    page.run("part('.cc').click(); part('.cc').click()")
    page.wait(f"{SHOWN} === 'café …&nosuch; b'")
    path.write_text(written)


def test_what_cannot_be_read_is_one_sentence(page: Page, url: str, folder: Path) -> None:
    shutil.copytree(folder / "static", folder / "wrong")
    (folder / "wrong" / "captions-en.vtt").write_bytes(bytes(range(256)))
    opened(page, url, "wrong&t=1.5")
    page.wait("part('.cc').checkVisibility()")
    page.run("part('.cc').click()")
    note = "part('.note').textContent"
    said = "The captions of this stream cannot be shown: captions-en.vtt is not WebVTT"
    page.wait(f"{note} === '{said}'")
    path = folder / "wrong" / "manifest.json"
    path.write_text(
        json.dumps({**json.loads(path.read_text()), "captions": [{"language": "../x"}]})
    )
    opened(page, url, "wrong")
    page.wait(f"{note}.startsWith('The captions of this stream cannot be shown: ')")
    assert page.value("element.error") is None


def test_a_long_caption_uses_the_width(page: Page, url: str) -> None:
    opened(page, url, "static&t=1.5")
    page.wait("part('.captions')")
    fill = "part('.captions').textContent = 'all the words of it '.repeat(30);"
    width_px = page.run(f"{fill} return part('.captions').offsetWidth")
    assert width_px == pytest.approx(0.86 * 640, abs=1)


ROW = """
for (let i = 0; i < 2; i++) await new Promise(requestAnimationFrame);
const row = part(".row");
const seen = [...row.children].filter((one) => one.checkVisibility() && one.className !== "space");
const boxes = seen.map((one) => one.getBoundingClientRect());
const middles = boxes.map(({ top, bottom }) => Math.round(top + bottom) / 2);
return {
  fits: row.scrollWidth <= row.clientWidth && new Set(middles).size === 1,
  order: boxes.every(({ left }, n) => n === 0 || left >= boxes[n - 1].right),
  names: seen.map((one) => one.classList[0]),
};
"""
"""What a row of buttons shows, and whether it is one row."""


@pytest.mark.parametrize("touch", [False, True])
def test_the_bar_is_one_row_at_any_width(page: Page, url: str, touch: bool) -> None:
    """With sound, captions and the LIVE badge; what has no room is in the menu."""
    address = f"{url}/player/watch.html?src=../static&autoplay=0&t=1.5"
    page.open(address, 900, 405, touch, options={"isMobile": touch})
    page.wait("part('.cc').checkVisibility() && part('.mute').checkVisibility()")
    page.run("player.live = true; player.dispatch('state')")
    found = {}
    for width_px in range(900, 300, -20):
        page.resize(width_px, 405)
        found[width_px] = page.run(ROW)
    assert [width for width, row in found.items() if not (row["fits"] and row["order"])] == []
    assert {"volume", "mute", "cc", "share", "reset", "rate"} <= {*found[900]["names"]}
    least = {"play", "badge", "share", "more", "full"}
    assert [(w, r["names"]) for w, r in found.items() if not least <= {*r["names"]}] == []
    page.run("part('.more').click()")
    page.wait("part('[data-name=rate]')")
    in_menu = page.value(
        "[...element.shadowRoot.querySelectorAll('.menu button')].map((one) => one.dataset.name)"
    )
    assert {"rate", "reset", "captions", "views", "pip", "fly"} - {*in_menu} <= {touch and "fly"}
    assert "loop" not in in_menu, "of what is live"
    assert page.value("element.shadowRoot.querySelector('select, input:not(.slider)')") is None
    assert {*in_menu} & {*found[320]["names"]} == set()
    page.resize(304, 171)
    page.wait("part('.large').checkVisibility()")
    boxes = [page.value(f"part('{name}').getBoundingClientRect()") for name in (".large", ".bar")]
    assert boxes[0]["top"] >= 0
    assert boxes[0]["bottom"] <= boxes[1]["top"]
