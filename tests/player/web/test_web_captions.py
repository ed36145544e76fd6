"""Captions in the page: reading files, and text over the picture."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from codec.errors import CorruptError, InvalidError
from codec.stream.captions import Captions, captions_of, check_captions, parse_webvtt
from codec.tools.static import export_static
from codec.tools.streamcaptions import add_captions
from scripts import webbundle
from tests.codec.tools.test_streamcaptions import VTT
from tests.support.hosted_streams import static_host, write_stream
from tests.support.web.browsercode import BrowserCode
from tests.support.web.chromium import Page

ELEMENT = "document.querySelector('swings-player')"
SHADOW = f"{ELEMENT}.shadowRoot"
SHOWN = f"{SHADOW}.querySelector('.captions').textContent"
BUTTON = f"{SHADOW}.querySelector('.cc')"
LINES = st.lists(
    st.sampled_from(
        [
            "",
            "1",
            "NOTE x",
            "00:00.000 --> 00:01.000",
            "00:00:00.500 --> 01:00:00.000 line:0",
            "00:0.5 --> 00:01.000",
            "a <b>bold</b> word",
            "1 &lt; 2 &amp;&nbsp;3",
            "it&#39;s &#x20AC;5 &#xD800;&#0;&#1114112; &; &#; &#x;",
            "<v Ann",
            "-->",
        ]
    ),
    max_size=12,
)


@settings(max_examples=150, deadline=None)
@given(lines=LINES, begin=st.sampled_from(["WEBVTT", "WEBVTT\tx", "WEBVTTx", ""]))
def test_files_are_read_as_in_the_package(
    browser: BrowserCode, lines: list[str], begin: str
) -> None:
    text = "\n".join([begin, *lines])
    said = browser.ask("cues", text=text, timeS=0.75)
    try:
        cues = parse_webvtt(text.encode())
    except CorruptError:
        assert said["cues"] is None
        return
    assert said["cues"] == [
        {"startS": cue.start_s, "endS": cue.end_s, "text": cue.text} for cue in cues
    ]
    due = [cue.text for cue in cues if cue.start_s <= 0.75 < cue.end_s]
    assert said["text"] == "\n".join(due)


def test_what_a_manifest_says_is_read_as_in_the_package(browser: BrowserCode) -> None:
    english = {"language": "en", "label": "English"}
    cases: list[tuple[bool, object]] = [
        (True, []),
        (True, [english, {"language": "pt-BR", "label": "Português (Brasil) 字幕 😀"}]),
        (True, [{"language": "en", "label": "x" * 80}]),
        (False, [english, english]),
        (False, [english, {"language": "EN", "label": "Upper"}]),
        (False, [{"language": "en", "label": ""}]),
        (False, [{"language": "en", "label": "x" * 81}]),
        (False, [{"language": "en", "label": "a\nb"}]),
        (False, [{"language": "en", "label": "a\u202eb"}]),
        (False, [{"language": "en", "label": "a\u00a0b"}]),
        (False, [{"language": "en"}]),
        (False, [{"language": "../x", "label": "x"}]),
        (False, [{"language": str(n), "label": "x"} for n in range(17)]),
        (False, {}),
    ]
    for is_right, captions in cases:
        try:
            check_captions(captions_of({"captions": captions}))
            is_taken = True
        except (CorruptError, InvalidError):
            is_taken = False
        assert browser.takes("captions", captions=captions) == is_taken == is_right, captions


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
    (folder / "player").symlink_to(webbundle.WEB / "bundle")
    return folder


@pytest.fixture(scope="module")
def url(folder: Path) -> Iterator[str]:
    with static_host(folder) as url:
        yield url


def open_stream(page: Page, url: str, name: str) -> None:
    page.open(f"{url}/player/watch.html?src=../{name}&autoplay=0", 640, 360)
    page.wait(f"{ELEMENT}?.player?.shownFrame >= 0")


def test_they_show_in_the_language_that_a_viewer_chooses(page: Page, url: str) -> None:
    open_stream(page, url, "static&t=1.5")
    page.wait(f"{BUTTON}?.checkVisibility()")
    assert page.run(f"return {SHOWN}") == ""
    page.run(f"{BUTTON}.click()")
    page.wait(f"{SHOWN} === '- Two\\n- lines'")
    assert page.run(f"return {BUTTON}.getAttribute('aria-label')") == "Captions: English"
    assert page.axe("swings-player") == []
    page.run(f"{ELEMENT}.focus()")
    page.press("Shift+C")
    page.wait(f"{SHOWN} === '- Zwei\\n- lines'")
    assert page.run(f"return {SHADOW}.querySelector('.captions').lang") == "de"
    page.run(f"{ELEMENT}.currentTime = 0.75")
    page.wait(f"{SHOWN} === 'Good day & night\\n- Zwei\\n- lines'")
    page.run(f"{ELEMENT}.currentTime = 2.5")
    page.wait(f"{SHOWN} === ''")
    page.press("Shift+C")
    page.wait(f"{BUTTON}.getAttribute('aria-pressed') === 'false'")
    page.run(f"{ELEMENT}.currentTime = 0.75")
    page.wait(f"!{ELEMENT}.seeking && {ELEMENT}.player.shownFrame === 23")
    assert page.run(f"return {SHOWN}") == ""
    assert not page.complaints


def test_the_language_stays_for_the_next_stream_and_one_without_has_no_button(
    page: Page, url: str
) -> None:
    open_stream(page, url, "static&t=1.5")
    page.wait(f"{BUTTON}?.checkVisibility()")
    page.run(f"{BUTTON}.click()")
    page.wait(f"{SHOWN} !== ''")
    page.run(f"{ELEMENT}.src = '../missing'; await null")
    assert page.run(f"return {SHOWN}") == "", "nothing of a stream that is closed"
    assert page.run(f"return {BUTTON}.checkVisibility()") is False
    page.run(f"{ELEMENT}.src = '../bare'")
    page.wait(f"{ELEMENT}.player.manifest && {ELEMENT}.player.shownFrame >= 0")
    page.wait(f"!{BUTTON}.checkVisibility()")
    assert page.run(f"return {SHOWN}") == ""
    page.run(f"{ELEMENT}.src = '../static'")
    page.wait(f"{SHOWN} !== ''")


def test_named_characters_are_those_of_browsers(page: Page, url: str, folder: Path) -> None:
    path = folder / "static" / "captions-de.vtt"
    written = path.read_text()
    path.write_text("WEBVTT\n\n00:00.000 --> 00:03.000\ncaf&eacute; &hellip;&nosuch; <b>b</b>\n")
    open_stream(page, url, "static&t=1.5")
    page.wait(f"{BUTTON}?.checkVisibility()")
    page.run(f"{BUTTON}.click(); {BUTTON}.click()")
    page.wait(f"{SHOWN} === 'café …&nosuch; b'")
    path.write_text(written)


def test_what_cannot_be_read_is_one_sentence(page: Page, url: str, folder: Path) -> None:
    (folder / "static" / "captions-en.vtt").write_bytes(bytes(range(256)))
    open_stream(page, url, "static&t=1.5")
    page.wait(f"{BUTTON}?.checkVisibility()")
    page.run(f"{BUTTON}.click()")
    note = f"{SHADOW}.querySelector('.note').textContent"
    page.wait(f"{note} === 'The captions cannot be shown: captions-en.vtt is not WebVTT'")
    path = folder / "static" / "manifest.json"
    described = path.read_text()
    path.write_text(json.dumps({**json.loads(described), "captions": [{"language": "../x"}]}))
    open_stream(page, url, "static")
    page.wait(f"{note}.startsWith('The captions of this stream cannot be shown: ')")
    assert page.run(f"return {ELEMENT}.error") is None
    assert not page.complaints
    path.write_text(described)
