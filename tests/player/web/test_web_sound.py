"""Sound in the page: the samples for Chromium's audio device, compared with the shown frames.

player/web/test/soundinstep.test.mjs checks in virtual time that both stay in step.
"""

from __future__ import annotations

import json
import random
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from codec.stream.sound import SoundSource
from tests.support.hosted_streams import static_host
from tests.support.web.chromium import Page
from tests.support.web.clicks import CLICK_FRAMES, write_clicking_stream
from tests.support.web.nodeprocess import SCRIPTS
from tests.support.web.site import LINKS, player_host

TAP = SCRIPTS / "soundtap.js"
NUM_FRAMES = 90
FPS = 30
CLICK_MS = 1000 * CLICK_FRAMES / FPS
APART_MS = 20
PARTS = """({
  label: part(".mute")?.getAttribute("aria-label"),
  pill: part(".unmute")?.checkVisibility() ?? false,
  volume: part(".volume")?.value,
  muted: element.muted,
})"""


@pytest.fixture(scope="module")
def host(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, Path]]:
    """A host with clicking streams, and its folder."""
    folder = tmp_path_factory.mktemp("sound")
    write_clicking_stream(folder / "plain", NUM_FRAMES, SoundSource("main", 2))
    # Frame 0's camera c0 looks along +z from the origin: this is to its right.
    right = SoundSource("right", 1, ((0.0, 3.0, 0.0, 0.5),))
    write_clicking_stream(folder / "placed", NUM_FRAMES, right)
    with player_host(folder) as url:
        yield url, folder


def opened(page: Page, url: str, query: str, *scripts: Path, width_px: int = 160) -> None:
    page.open(f"{url}/player/watch.html?src=../{query}", width_px, 120, scripts=[TAP, *scripts])
    page.wait("player.shownFrame >= 0")


def wait_for_clicks(page: Page, count: int) -> None:
    page.run("clicks.length = shown.length = 0")
    page.wait(f"clicks.length >= {count}")


def apart_ms(page: Page) -> np.ndarray:
    """The delay of each click's picture after the click, in milliseconds, including the usual delay
    between the due time of a picture and its drawing."""
    zero = "zeroMs: player.line.zeroMs - performance.timeOrigin"
    found = page.value(f"({{ clicks, shown, rate: player.line.rate, {zero} }})")
    step_ms = 1000 / FPS / found["rate"]
    round_ms = step_ms * NUM_FRAMES

    def phase_ms(time_ms: float) -> float:
        """`time_ms` in the loop, from minus half of its length to half of it."""
        return float((time_ms + round_ms / 2) % round_ms - round_ms / 2)

    late_ms = np.median(
        [phase_ms(one["atMs"] - found["zeroMs"] - step_ms * one["frame"]) for one in found["shown"]]
    )
    click_ms = CLICK_MS / found["rate"]
    heard = [phase_ms(one["heardMs"] - found["zeroMs"] - late_ms) for one in found["clicks"]]
    return np.asarray([(time + click_ms / 2) % click_ms - click_ms / 2 for time in heard])


def check_in_step(page: Page, count: int) -> None:
    """Waits until clicks and flashes are in step, at most six times `count` clicks. The delay of
    pictures varies with the load of the machine, and the sound follows it slowly."""
    for _ in range(6):
        wait_for_clicks(page, count)
        found = np.abs(apart_ms(page)).max()
        if found <= APART_MS:
            return
    raise AssertionError(f"{found:.0f} ms apart")


@pytest.mark.realtime
def test_clicks_are_heard_with_their_pictures(page: Page, host: tuple[str, Path]) -> None:
    """Clicks stay in step through loops, which have no gap, after seeks, after a pause and at
    another speed."""
    opened(page, host[0], "plain/static")
    wait_for_clicks(page, 9)  # a loop and a half
    times = page.value("clicks.map(({ atS }) => 1000 * atS)")
    assert np.diff(times) == pytest.approx(CLICK_MS, abs=1), "no gap at the end of a round"
    check_in_step(page, 3)
    rng = random.Random(3)
    for _ in range(4):
        page.run("element.currentTime = value", rng.uniform(0, 2.9))
        page.wait("!element.seeking && player.line?.zeroMs")
        check_in_step(page, 3)
    page.run("element.pause(); await new Promise((done) => setTimeout(done, 300)); element.play()")
    check_in_step(page, 3)
    page.run("element.playbackRate = 1.5")
    page.wait("player.line?.rate === 1.5 && player.line.zeroMs")
    check_in_step(page, 4)


def test_a_placed_source_is_heard_from_its_side(page: Page, host: tuple[str, Path]) -> None:
    opened(page, host[0], "placed/static")
    wait_for_clicks(page, 2)
    peaks = page.value("clicks.at(-1).levels")
    assert len(peaks) == 2
    assert abs(peaks[1]) > 4 * abs(peaks[0])


def test_pause_mute_volume_and_keys(page: Page, host: tuple[str, Path]) -> None:
    opened(page, host[0], "plain/static", width_px=640)
    wait_for_clicks(page, 2)
    page.run("element.pause()")
    page.wait_until_still("clicks.length")
    page.run("element.play()")
    wait_for_clicks(page, 1)
    loud = page.value("Math.abs(clicks[0].levels[0])")
    assert loud > 0.2
    assert page.value(PARTS) == {"label": "Mute", "pill": False, "volume": "1", "muted": False}
    page.run("element.focus()")
    page.press("m")
    page.wait("element.muted")
    assert page.value(PARTS) == {"label": "Unmute", "pill": False, "volume": "0", "muted": True}
    page.wait_until_still("clicks.length")
    page.press("M")
    page.wait("!element.muted")
    wait_for_clicks(page, 1)
    page.run("part('.volume').focus(); element.pause(); element.currentTime = 1")
    page.wait("player.shownFrame === 30 && !element.seeking")
    for _ in range(4):
        page.press("ArrowLeft")
    assert page.value("element.volume") == pytest.approx(0.8)
    page.press("Home")
    assert page.value(PARTS)["label"] == "Unmute", "no volume is silence"
    assert page.value("element.currentTime") == 1, "no arrow has skipped"
    page.run("part('.mute').click()")
    assert page.value(PARTS)["volume"] == "1"
    page.press("?")
    page.wait("part('.keylist').open")
    assert "Mute" in page.value("part('.keylist').textContent")
    page.press("?")
    assert page.axe("swings-player") == []


BLOCKED = """
let [state, isPressed] = ["suspended", false];
Object.defineProperty(AudioContext.prototype, "state", { configurable: true, get: () => state });
window.resumes = 0;
AudioContext.prototype.resume = async function () {
  window.resumes += 1;
  if (!isPressed) return;
  state = "running";
  this.dispatchEvent(new Event("statechange"));
};
addEventListener("click", () => (isPressed = true), { capture: true });
"""
"""An AudioContext that starts only in a click or after one, as in a browser that blocks sound."""


def test_a_browser_that_waits_for_a_person(
    page: Page, host: tuple[str, Path], tmp_path: Path
) -> None:
    (tmp_path / "blocked.js").write_text(BLOCKED)
    opened(page, host[0], "plain/static", tmp_path / "blocked.js")
    page.wait("state.playing && part('.unmute').checkVisibility()")
    assert page.value(PARTS) == {"label": "Unmute", "pill": True, "volume": "1", "muted": False}
    assert page.axe("swings-player") == []
    shown = page.value("player.shownFrame")
    page.wait(f"player.shownFrame !== {shown}")  # the pictures play without sound
    assert page.value("clicks.length") == 0
    assert page.value("resumes") <= 2, "asked once, and again by a person alone"
    page.click(".unmute")
    wait_for_clicks(page, 2)
    assert page.value(PARTS)["pill"] is False


@pytest.mark.realtime
def test_a_link_that_carries_layer_0_carries_the_sound(page: Page, tmp_path: Path) -> None:
    (tmp_path / "player").symlink_to(LINKS["player"])
    frames = 240
    source = SoundSource("main", 2)
    static = write_clicking_stream(tmp_path, frames, source, slice_size=160)
    segments = [path.parent for path in static.glob("segments/*/0")]

    def need_bps(*parts: str) -> float:
        size_bytes = sum((segment / part).stat().st_size for segment in segments for part in parts)
        return 8 * size_bytes * FPS / frames

    link_bps = 1.4 * need_bps("0", "skipmaps", source.part)
    assert link_bps < need_bps("0", "1"), "no second layer"
    with static_host(tmp_path, objects_bps=link_bps) as url:
        opened(page, url, "static&loop=0")
        page.wait("element.ended")
    stalls = page.value("state.stalls")
    times = page.value("clicks.map(({ atS }) => 1000 * atS)")
    # Sound waits with the picture; between such places there is no gap.
    assert len(times) >= frames / CLICK_FRAMES - 1 - stalls
    assert np.sum(np.abs(np.diff(times) - CLICK_MS) > 1) <= stalls


def test_hostile_sound_is_one_sentence_and_the_picture_plays_on(
    page: Page, host: tuple[str, Path]
) -> None:
    url, folder = host
    write_clicking_stream(folder / "hostile", NUM_FRAMES, SoundSource("main", 2))
    static = folder / "hostile" / "static"
    rng = random.Random(1)
    for path in static.glob("segments/*/audio-main"):
        data = bytearray(path.read_bytes())
        match rng.randrange(4):
            case 0:
                data = bytearray(rng.randbytes(len(data)))
            case 1:
                del data[rng.randrange(len(data)) :]
            case 2:
                data[rng.randrange(36, len(data))] ^= 0xFF
            case _:
                data.clear()
        path.write_bytes(data)
    opened(page, url, "hostile/static")
    note = "part('.note').textContent"
    page.wait(f"{note}.startsWith('Some of the sound cannot be played: sound: ')")
    page.wait("state.frame > 60")
    assert page.value("element.error") is None
    assert page.value("clicks.length") == 0
    manifest = json.loads((static / "manifest.json").read_text())
    (static / "manifest.json").write_text(json.dumps({**manifest, "sound": [{"name": 3}]}))
    opened(page, url, "hostile/static")
    page.wait(f"{note}.startsWith('The sound of this stream cannot be played: ')")
    page.wait("state.frame > 5")
    assert page.value("part('.mute').checkVisibility()") is False
