"""Captions of the window: their choice and times, from every kind of source, and their layout."""

from __future__ import annotations

import logging
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from codec.errors import CorruptError, InvalidError
from codec.framerange import FrameRange
from codec.stream.captions import Captions
from codec.stream.streampacker import pack_stream
from codec.tracks.streamtracks import add_captions
from player.show.captionchoice import MAX_LINE_CHARS, MAX_LINES, CaptionChoice
from player.show.overlay import caption_panel
from player.source.opener import Opener
from tests.support.delivery.rangehost import range_host
from tests.support.hosted_streams import served, write_stream
from tests.support.waiting import wait_until

ENGLISH = "WEBVTT\n\n00:00.500 --> 00:02.000\nTwo\nlines\n\n00:01.000 --> 00:03.000\n<i>third</i>\n"
FRENCH = "WEBVTT\n\n00:00.000 --> 00:09.000\nDeux\n"
TRACKS = (Captions("en", "English"), Captions("fr", "French"), Captions("de", "German"))


def read(name: str) -> bytes:
    if name == "captions-de.vtt":
        raise CorruptError(f"{name} is missing")
    return (ENGLISH if name == "captions-en.vtt" else FRENCH).encode()


def test_the_key_goes_through_the_languages_and_cues_show_in_their_time(
    caplog: pytest.LogCaptureFixture,
) -> None:
    choice = CaptionChoice(TRACKS, read)
    assert choice.lines(1.5) == ()
    choice.next()
    wait_until(lambda: choice.lines(1.5))
    shown = [choice.lines(at_s) for at_s in (0.4, 0.5, 1.0, 2.0, 3.0)]
    both = ("Two", "lines", "third")
    assert shown == [(), ("Two", "lines"), both, ("third",), ()]
    choice.next()
    wait_until(lambda: choice.lines(1.5) == ("Deux",))
    with caplog.at_level(logging.WARNING):
        choice.next()
        wait_until(lambda: "no captions in de: captions-de.vtt is missing" in caplog.text)
    assert choice.lines(1.5) == ()
    choice.next()
    assert choice.chosen is None
    choice.next()
    assert choice.lines(1.0) == both, "what was read is not read again"


def test_a_language_that_there_is_not_is_one_line() -> None:
    assert CaptionChoice(TRACKS, read, "FR").chosen == TRACKS[1]
    for tracks, there in ((TRACKS, "en, fr, de"), ((), "none at all")):
        with pytest.raises(InvalidError, match=f"captions it: this stream has {there}"):
            CaptionChoice(tracks, read, "it")


def test_they_come_from_every_kind_of_source(tmp_path: Path) -> None:
    stream = write_stream(tmp_path / "s", 10)
    (tmp_path / "in.vtt").write_text(ENGLISH)
    add_captions(stream, tmp_path / "in.vtt", TRACKS[0])
    pack_stream(stream, tmp_path / "packed.swings")
    with served(tmp_path) as server, range_host(tmp_path) as host:
        folders = [f"{place}/{s}" for place in (tmp_path, host.url) for s in ("s", "packed.swings")]
        for source in (*folders, f"{server.url}/watch/s", f"{server.url}/watch/packed"):
            with closing(Opener(source)) as opener:
                opener.open(FrameRange(), None).close()
                assert opener.read_captions("captions-en.vtt").decode() == ENGLISH, source


@given(
    st.lists(st.text("abc WÅ", min_size=1, max_size=60), max_size=4),
    st.integers(1, 2000),
    st.integers(1, 1200),
)
@settings(deadline=None, max_examples=25)
def test_a_panel_is_no_wider_than_the_picture(lines: list[str], width: int, height: int) -> None:
    pixels = caption_panel(lines, (width, height))
    assert pixels.shape[1] <= width
    if "".join(lines).split() and width > 200:
        assert (pixels > 250).all(axis=2).any(), "there is text"


def test_letters_of_many_languages_are_drawn() -> None:
    missing = caption_panel(["\U000effff"], (640, 360))
    for letter in "éłйαע":
        drawn = caption_panel([letter], (640, 360))
        assert drawn.shape != missing.shape or (drawn != missing).any()


@pytest.mark.parametrize("text", ["W" * 900_000, "a\n" * 400_000, "W " * 400_000])
def test_a_strangers_text_fills_no_memory(text: str) -> None:
    content = f"WEBVTT\n\n00:00.000 --> 00:09.000\n{text}\n".encode()
    choice = CaptionChoice(TRACKS, lambda name: content, "en")
    wait_until(lambda: bool(choice.lines(1)))
    lines = choice.lines(1)
    assert len(lines) <= MAX_LINES
    assert max(map(len, lines)) <= MAX_LINE_CHARS
    assert (caption_panel(lines, (320, 240)).shape[:2] <= np.array([240, 320])).all()
    assert len(caption_panel(["word " * 40], (200, 240))) > 100, "wrapped between words"
