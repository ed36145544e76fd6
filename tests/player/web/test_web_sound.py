"""Sound in the page: the samples for Chromium's audio device, compared with the shown frames."""

from __future__ import annotations

import json
import random
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from codec.stream.sound import SoundSource
from scripts import webbundle
from tests.support.hosted_streams import static_host
from tests.support.web.chromium import Page
from tests.support.web.clicks import CLICK_FRAMES, write_clicking_stream
from tests.support.web.nodeprocess import NODE

ROOT = Path(__file__).parents[3]
TAP = Path(__file__).with_name("soundtap.js")
ELEMENT = "document.querySelector('swings-player')"
SHADOW = f"{ELEMENT}.shadowRoot"
NUM_FRAMES = 90
FPS = 30
CLICK_MS = 1000 * CLICK_FRAMES / FPS
APART_MS = 20
HEARD_OUT_MS = 100
"""Longest time for which earlier samples are heard after a seek: the device delays them by 60 ms,
and fading takes 20."""

PARTS = f"""
const parts = {SHADOW};
const of = (name) => parts.querySelector(name);
return {{
  label: of(".mute")?.getAttribute("aria-label"),
  pill: of(".unmute")?.checkVisibility() ?? false,
  volume: of(".volume")?.value,
  muted: {ELEMENT}.muted,
}};
"""


@pytest.fixture(scope="module")
def host(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, Path]]:
    """A host with clicking streams, and its folder."""
    folder = tmp_path_factory.mktemp("sound")
    (folder / "web").symlink_to(ROOT / "player" / "web")
    (folder / "bundle").symlink_to(webbundle.WEB / "bundle")
    write_clicking_stream(folder / "plain", NUM_FRAMES, SoundSource("main", 2))
    # Frame 0's camera c0 looks along +z from the origin: this is to its right.
    right = SoundSource("right", 1, ((0.0, 3.0, 0.0, 0.5),))
    write_clicking_stream(folder / "placed", NUM_FRAMES, right)
    with static_host(folder) as url:
        yield url, folder


def simulated(fps: float, frames: int, lasts_s: float, seed: int, what: str) -> Any:
    """The results of soundsim.mjs, with the times of its clicks and flashes as arrays."""
    if NODE is None:
        pytest.skip("needs Node.js: apt-get install nodejs")
    script = Path(__file__).with_name("soundsim.mjs")
    command = [NODE, str(script), *map(str, (fps, frames, CLICK_FRAMES, lasts_s, seed, what))]
    done = subprocess.run(command, capture_output=True, text=True, timeout=240)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    shown = [one["atMs"] for one in found["shown"] if one["frame"] % CLICK_FRAMES == 0]
    heard = np.asarray([time for time in found["heard"] if time < found["endMs"] - 100])
    return {**found, "flashes": np.asarray(shown), "clicks": heard}


@pytest.mark.parametrize("seed", [7, 8, 9])
def test_ten_minutes_of_clicks_and_flashes(seed: int) -> None:
    """Virtual time, clocks that differ by 200 ppm, 20 seeks, 3 stalls, and loops of 10 s: each
    click is in step with its flash, except samples that the device had before a seek."""
    frames, lasts_s = 300, 600
    found = simulated(FPS, frames, lasts_s, seed, "seeks")
    flashes, clicks = found["flashes"], found["clicks"]
    disturbed = np.asarray(found["disturbed"])
    assert len(disturbed) == 23
    assert (found["stalls"], found["gaps"]) == (3, 0)
    assert len(clicks) > 0.9 * lasts_s * FPS / CLICK_FRAMES
    after_ms = clicks[:, None] - disturbed
    is_old = ((after_ms > 0) & (after_ms < HEARD_OUT_MS)).any(axis=1)
    apart = np.abs(clicks[~is_old, None] - flashes).min(axis=1)
    assert apart.max() <= APART_MS


def test_a_live_stream_goes_on_with_its_sound_and_loops_once_it_is_finished() -> None:
    """The stream grows by half a second for 20 s, ends with a part of a segment, and loops."""
    found = simulated(FPS, 60, 60, 1, "live")
    flashes, clicks = found["flashes"], found["clicks"]
    assert (found["stalls"], found["gaps"], found["isOldWanted"]) == (0, 0, False)
    assert len(flashes) - len(clicks) in range(3)
    assert np.abs(clicks[:, None] - flashes).min(axis=1).max() <= APART_MS
    assert np.diff(clicks).max() < 1.1 * CLICK_MS


def test_a_loop_that_is_switched_off_near_its_end_is_silent_after_it() -> None:
    found = simulated(FPS, 90, 12, 1, "once")
    flashes, clicks = found["flashes"], found["clicks"]
    assert len(flashes) == 2 * 90 / CLICK_FRAMES
    assert len(flashes) - len(clicks) in range(2), "the first one may come before the sound"
    assert np.abs(clicks[:, None] - flashes).min(axis=1).max() <= APART_MS


def test_many_short_rounds_stay_in_step() -> None:
    """A round of 3 frames at 29.97 fps has 4804.8 samples."""
    found = simulated(29.97, 3, 200, 1, "loop")
    flashes, clicks = found["flashes"], found["clicks"]
    assert (found["stalls"], found["gaps"]) == (0, 0)
    assert np.abs(clicks[:, None] - flashes).min(axis=1).max() <= APART_MS


def open_stream(page: Page, url: str, query: str, player: str = "web") -> None:
    address = f"{url}/{player}/watch.html?src=../{query}"
    page.open(address, 640, 200, scripts=[TAP])  # a small picture: software draws it
    page.wait(f"{ELEMENT}?.player?.shownFrame >= 0")


def wait_for_clicks(page: Page, count: int) -> None:
    page.run("clicks.length = shown.length = 0")
    page.wait(f"clicks.length >= {count}", 60)


def apart_ms(page: Page) -> np.ndarray:
    """The delay of each click's picture after the click, in milliseconds, including the usual delay
    between the due time of a picture and its drawing."""
    found = page.run(f"""
      const {{ line }} = {ELEMENT}.player;
      return {{ clicks, shown, rate: line.rate, zeroMs: line.zeroMs - performance.timeOrigin }};
    """)
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


def test_clicks_are_heard_with_their_pictures(page: Page, host: tuple[str, Path]) -> None:
    """Clicks stay in step through loops, which have no gap, after seeks and at another speed."""
    open_stream(page, host[0], "plain/static")
    wait_for_clicks(page, 9)  # a loop and a half
    times = page.run("return clicks.map(({ atS }) => 1000 * atS)")
    assert np.diff(times) == pytest.approx(CLICK_MS, abs=1), "no gap at the end of a round"
    check_in_step(page, 3)
    rng = random.Random(3)
    for _ in range(4):
        page.run(f"{ELEMENT}.currentTime = value", rng.uniform(0, 2.9))
        page.wait(f"!{ELEMENT}.seeking && {ELEMENT}.player.line?.zeroMs")
        check_in_step(page, 3)
    page.run(f"{ELEMENT}.playbackRate = 1.5")
    page.wait(f"{ELEMENT}.player.line?.rate === 1.5 && {ELEMENT}.player.line.zeroMs")
    check_in_step(page, 4)
    assert not page.complaints


def test_a_pause_is_silent_and_playing_goes_on_in_step(page: Page, host: tuple[str, Path]) -> None:
    open_stream(page, host[0], "plain/static")
    wait_for_clicks(page, 2)
    page.run(f"{ELEMENT}.pause(); await new Promise((done) => setTimeout(done, 300))")
    page.run("clicks.length = 0; await new Promise((done) => setTimeout(done, 1500))")
    assert page.run("return clicks.length") == 0
    page.run(f"{ELEMENT}.play()")
    check_in_step(page, 3)


def test_a_placed_source_is_heard_from_its_side(page: Page, host: tuple[str, Path]) -> None:
    open_stream(page, host[0], "placed/static")
    wait_for_clicks(page, 2)
    peaks = page.run("return clicks.at(-1).levels")
    assert len(peaks) == 2
    assert abs(peaks[1]) > 4 * abs(peaks[0])


def test_mute_volume_and_keys(page: Page, host: tuple[str, Path]) -> None:
    open_stream(page, host[0], "plain/static", "bundle")
    wait_for_clicks(page, 1)
    assert page.run(PARTS) == {"label": "Mute", "pill": False, "volume": "1", "muted": False}
    page.run(f"{ELEMENT}.focus()")
    page.press("m")
    page.wait(f"{ELEMENT}.muted")
    assert page.run(PARTS) == {"label": "Unmute", "pill": False, "volume": "0", "muted": True}
    page.run("clicks.length = 0; await new Promise((done) => setTimeout(done, 1200))")
    assert page.run("return clicks.length") <= 1, "silent, once what was on its way is heard"
    page.press("M")
    page.wait(f"!{ELEMENT}.muted")
    wait_for_clicks(page, 1)
    loud = page.run("return Math.abs(clicks[0].levels[0])")
    page.run(f"{SHADOW}.querySelector('.volume').focus()")
    page.run(f"{ELEMENT}.pause(); await new Promise((done) => setTimeout(done, 1000))")
    time_s = page.run(f"return {ELEMENT}.currentTime")
    for _ in range(4):
        page.press("ArrowLeft")
    assert page.run(f"return {ELEMENT}.volume") == pytest.approx(0.8)
    page.press("Home")
    assert page.run(PARTS)["label"] == "Unmute", "no volume is silence"
    assert page.run(f"return {ELEMENT}.currentTime") == time_s
    page.run(f"{SHADOW}.querySelector('.mute').click()")
    assert page.run(PARTS)["volume"] == "1"
    assert loud > 0.2
    page.press("?")
    page.wait(f"{SHADOW}.querySelector('.keylist')?.open")
    assert "Mute" in page.run(f"return {SHADOW}.querySelector('.keylist').textContent")
    page.press("?")
    assert page.axe("swings-player") == []
    assert not page.complaints


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
    page.open(
        f"{host[0]}/bundle/watch.html?src=../plain/static",
        640,
        200,
        scripts=[TAP, tmp_path / "blocked.js"],
    )
    page.wait(f"{ELEMENT}?.player?.state.playing")
    page.wait(f"{SHADOW}.querySelector('.unmute')?.checkVisibility()")
    assert page.run(PARTS) == {"label": "Unmute", "pill": True, "volume": "1", "muted": False}
    assert page.axe("swings-player") == []
    shown = page.run(f"return {ELEMENT}.player.shownFrame")
    page.wait(f"{ELEMENT}.player.shownFrame !== {shown}")  # the pictures play without sound
    assert page.run("return clicks.length") == 0
    assert page.run("return resumes") <= 2, "asked once, and again by a person alone"
    page.click(".unmute")
    wait_for_clicks(page, 2)
    assert page.run(PARTS)["pill"] is False


def test_a_link_that_carries_layer_0_and_no_more_carries_the_sound(
    page: Page, tmp_path: Path
) -> None:
    (tmp_path / "web").symlink_to(ROOT / "player" / "web")
    frames = 240
    source = SoundSource("main", 2)
    static = write_clicking_stream(tmp_path, frames, source, slice_size=160)
    segments = [path.parent for path in static.glob("segments/*/0")]

    def need_bps(*parts: str) -> float:
        size_bytes = sum((segment / part).stat().st_size for segment in segments for part in parts)
        return 8 * size_bytes * FPS / frames

    link_bps = 1.4 * need_bps("0", "masks", source.part)
    assert link_bps < need_bps("0", "1"), "no second layer"
    with static_host(tmp_path, objects_bps=link_bps) as url:
        open_stream(page, url, "static&loop=0")
        page.wait(f"{ELEMENT}.ended", 100)
    stalls = page.run(f"return {ELEMENT}.player.state.stalls")
    times = page.run("return clicks.map(({ atS }) => 1000 * atS)")
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
    open_stream(page, url, "hostile/static")
    note = f"{SHADOW}.querySelector('.note').textContent"
    page.wait(f"{note}.startsWith('Some of the sound cannot be played: sound: ')")
    page.wait(f"{ELEMENT}.player.state.frame > 60")
    assert page.run(f"return {ELEMENT}.error") is None
    assert page.run("return clicks.length") == 0
    assert not page.complaints
    manifest = json.loads((static / "manifest.json").read_text())
    (static / "manifest.json").write_text(json.dumps({**manifest, "sound": [{"name": 3}]}))
    open_stream(page, url, "hostile/static")
    page.wait(f"{note}.startsWith('The sound of this stream cannot be played: ')")
    page.wait(f"{ELEMENT}.player.state.frame > 5")
    assert page.run(f"return {SHADOW}.querySelector('.mute').checkVisibility()") is False
    assert not page.complaints
