"""The bundle in the browsers that people have: what a viewer does in the first minute works."""

from __future__ import annotations

from pathlib import Path

import pytest

from codec.stream.captions import Captions
from codec.stream.reader import StreamReader
from codec.tools.static import export_static
from codec.tracks.streamtracks import add_captions
from tests.codec.tracks.test_streamsound import VTT
from tests.support.hosted_streams import served
from tests.support.slots.moving_updates import write_moving_stream
from tests.support.slots.slot_streams import write_busy_stream
from tests.support.slots.updates import small_layout
from tests.support.sounding import add_clicks
from tests.support.web.canvas import PIXELS, check_picture
from tests.support.web.otherbrowsers import running_browser
from tests.support.web.site import player_host

DECODED = """
const { readSoundObject } = await import("/web/sound/soundobject.js");
const { oggOf } = await import("/web/sound/soundobject.js");
const found = await fetch("/static/segments/0/audio-main");
const { packets, positions } = readSoundObject(new Uint8Array(await found.arrayBuffer()), 2);
const file = oggOf(packets, positions, 2);
const context = new OfflineAudioContext(2, 48000, 48000);
return (await context.decodeAudioData(await new Blob([file]).arrayBuffer())).length;
"""


def write_streams(folder: Path) -> StreamReader:
    stream = folder / "trained" / "stream"
    write_moving_stream(stream, 90, small_layout(1, (60, 40), 1, 15))
    add_clicks(stream, (0, 45))
    (folder / "in.vtt").write_text(VTT)
    add_captions(stream, folder / "in.vtt", Captions("en", "English"))
    export_static(stream, folder / "static")
    busy = folder / "trained" / "busy"
    write_busy_stream(busy, 45, small_layout(1, (40, 30, 20), 1, 15))
    return StreamReader(busy)


# The other tests have Chromium's code; with its window and 60 pictures a second it is dear.
@pytest.mark.parametrize(
    "kind", [pytest.param("chromium", marks=pytest.mark.realtime), "firefox", "webkit"]
)
def test_a_viewer_s_first_minute(kind: str, tmp_path: Path) -> None:
    reader = write_streams(tmp_path)
    with (
        running_browser(kind) as page,
        player_host(tmp_path) as host,
        served(tmp_path / "trained") as server,
    ):
        page.open(f"{host}/player/watch.html?src=../static&autoplay=0&loop=1", 480, 320)
        page.wait("player.shownFrame === 0 && part('.bar') && part('.cc')")
        # Captions.
        page.run("part('.cc').click(); element.currentTime = 1.5")
        page.wait("part('.captions').textContent === '- Two\\n- lines'")
        # The menu.
        page.run("part('.more').click()")
        page.wait("part('.menu').checkVisibility()")
        page.press("Escape")
        page.wait("!part('.menu').checkVisibility()")
        # A drag.
        before = page.value("element.view")
        page.drag((240, 120), (300, 140))
        assert page.value("element.view") != before
        # Play, slowly, with motion between frames; then over the loop's end.
        page.run("element.muted = true; element.playbackRate = 0.1; element.play()")
        page.wait("player.view.smoothing.isMoving")
        page.run("element.playbackRate = 2")
        page.wait("player.shownFrame > 60")
        page.wait("player.shownFrame < 30")
        page.run("element.pause()")
        assert page.run(DECODED) > 0
        assert page.take_complaints() == []
        # From a server, which chooses what it sends; a seek, and the picture there.
        page.open(f"{server.url}/watch/busy?autoplay=0", 480, 320)
        page.wait("player.shownFrame === 0 && part('.bar')")
        # On a busy machine the server would choose fewer layers.
        page.run("element.layers = value; element.play()", reader.manifest.num_layers)
        page.wait("player.shownFrame > 20")
        page.run("element.pause(); element.currentTime = 1")
        page.wait(f"player.shownFrame === 30 && state.layers === {reader.manifest.num_layers}")
        page.run(PIXELS.read_text())
        check_picture(page, reader, 30)
        assert page.take_complaints() == []
