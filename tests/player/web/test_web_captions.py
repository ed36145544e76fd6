"""Captions in the page: reading files, and text over the picture."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from codec.stream.captions import Captions
from codec.tools.static import export_static
from codec.tools.streamcaptions import add_captions
from tests.codec.tools.test_streamsound import VTT
from tests.support.hosted_streams import write_stream
from tests.support.web.chromium import Page
from tests.support.web.site import player_host, watch

SHOWN = "part('.captions').textContent"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("captions")
    stream = write_stream(folder / "trained", 90)
    export_static(stream, folder / "bare")
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
    page.press("Shift+C")
    page.wait(f"{SHOWN} === '- Zwei\\n- lines'")
    assert page.value("part('.captions').lang") == "de"
    page.run("element.currentTime = 0.75")
    page.wait(f"{SHOWN} === 'Good day & night\\n- Zwei\\n- lines'")
    page.run("element.currentTime = 2.5")
    page.wait(f"{SHOWN} === ''")
    page.press("Shift+C")
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
    page.wait("player.manifest && player.shownFrame >= 0")
    page.wait("!part('.cc').checkVisibility()")
    assert page.value(SHOWN) == ""
    page.run("element.src = '../static'")
    page.wait(f"{SHOWN} !== ''")


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
    page.wait(f"{note} === 'The captions cannot be shown: captions-en.vtt is not WebVTT'")
    path = folder / "wrong" / "manifest.json"
    path.write_text(
        json.dumps({**json.loads(path.read_text()), "captions": [{"language": "../x"}]})
    )
    opened(page, url, "wrong")
    page.wait(f"{note}.startsWith('The captions of this stream cannot be shown: ')")
    assert page.value("element.error") is None
