"""`<swings-player>` as the media element that other controls and recorders expect."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from codec.tools.static import export_static
from tests.support.hosted_streams import static_host
from tests.support.slots.slot_streams import write_busy_stream
from tests.support.slots.updates import small_layout
from tests.support.web.chromium import Page
from tests.support.web.nodeprocess import SCRIPTS

ROOT = Path(__file__).parents[3]
NUM_FRAMES = 45
MAKE = """
await import("/web/element/swingsplayer.js");
window.player = document.createElement("swings-player");
window.heard = [];
const events = ["loadstart", "suspend", "durationchange", "loadedmetadata", "loadeddata", "canplay",
  "canplaythrough", "play", "playing", "pause", "seeking", "seeked", "ratechange", "volumechange",
  "emptied", "abort", "ended", "error"];
for (const type of events) player.addEventListener(type, () => heard.push(type));
for (const [name, text] of Object.entries(value)) player.setAttribute(name, text);
document.body.append(player);
window.numHolds = 0;
player.player.keepAlive = () => {
  numHolds += 1;
  return () => (numHolds -= 1);
};
return [player.networkState, player.readyState];
"""


@pytest.fixture(scope="module")
def host(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The URL of a host: the player in web/, npm packages in npm/, a stream of 1.5 s in stream/."""
    path = tmp_path_factory.mktemp("media")
    write_busy_stream(path / "trained", NUM_FRAMES, small_layout(1, (40, 30, 20), 0, 15))
    export_static(path / "trained", path / "stream")
    (path / "web").symlink_to(ROOT / "player" / "web")
    (path / "npm").symlink_to(SCRIPTS / "node_modules")
    (path / "empty.html").write_text('<!doctype html><link rel="icon" href="data:," />')
    with static_host(path) as url:
        yield url


def ranges(name: str) -> str:
    """The expression for the ranges of a property, as pairs of seconds."""
    return f"Array.from(player.{name}, (_, i) => [player.{name}.start(i), player.{name}.end(i)])"


OUTCOME = "(promise) => promise.then(() => 'playing', (error) => error.name)"


def test_it_loads_plays_and_ends_as_a_media_element(page: Page, host: str) -> None:
    def heard() -> list[str]:
        """The events since the last call."""
        found: list[str] = page.run("return heard.splice(0)")
        return found

    page.open(f"{host}/empty.html", 480, 320)
    assert page.run(MAKE, {"src": "stream", "preload": "metadata"}) == [2, 0]
    page.wait("player.networkState === 1")
    metadata = ["loadstart", "durationchange", "loadedmetadata", "suspend"]
    assert heard() == metadata
    # Only the description was fetched.
    assert page.run("return [player.readyState, player.player.state.receivedBytes]") == [1, 0]
    assert page.run("return player.currentSrc") == f"{host}/stream"
    assert page.run(f"return [{ranges('seekable')}, {ranges('buffered')}]") == [[[0, 1.5]], []]
    assert page.run("return [player.videoWidth, player.videoHeight]") == [464, 261]

    page.run("player.playbackRate = 0.5")
    assert page.run(f"return ({OUTCOME})(player.play())") == "playing"
    page.wait("heard.includes('ended')", 30)
    loaded = ["ratechange", "play", "loadeddata", "canplay", "playing"]
    found = heard()
    assert [event for event in found if event not in ("canplaythrough", "suspend")] == [
        *loaded,
        "pause",
        "ended",
    ]
    assert found.count("canplaythrough") == 1
    assert page.run(f"return [{ranges('played')}, {ranges('buffered')}.at(-1)[1]]") == [
        [[0, 1.5]],
        1.5,
    ]
    page.wait("player.networkState === 1 && player.readyState === 4")
    assert page.run("try { player.played.end(1) } catch (e) { return e.name }") == "IndexSizeError"

    page.run("heard.length = 0; player.volume = 0.5; player.muted = true; player.muted = true")
    assert heard() == ["volumechange", "volumechange"]
    page.run("player.muted = false; player.defaultMuted = true")
    assert heard() == ["volumechange"]
    assert page.run("return player.muted") is False, "the attribute has no effect later"
    page.run("player.defaultMuted = false")
    # Promises of play() for which playback never starts.
    paused = f"player.load(); const played = ({OUTCOME})(player.play()); player.pause();"
    assert page.run(f"{paused} return played") == "AbortError"
    assert heard() == ["abort", "emptied", "ratechange", "loadstart", "play", "pause"]
    replaced = f"const played = ({OUTCOME})(player.play()); player.src = 'none';"
    failing = f"return [await played, await ({OUTCOME})(player.play())]"
    assert page.run(f"{replaced} {failing}") == ["AbortError", "NotSupportedError"]
    assert page.run("return [player.error.code, player.networkState, player.readyState]") == [
        *(4, 3, 0),
    ]
    assert page.run(f"return ({OUTCOME})(player.play())") == "NotSupportedError"
    assert heard() == ["play", "abort", "emptied", "loadstart", "play", "error"]


TRANSCRIPT = """
const { Readiness } = await import("/web/element/readiness.js");
const readiness = new Readiness();
const events = [readiness.select(), readiness.open(0)];
const state = { fps: 30, frame: 0, endFrame: 0, numFrames: 300, live: false, waiting: true,
  playing: true, isShown: false, isSeeking: false, receivedBytes: 0 };
for (const [nowS, changes] of value) {
  events.push([...readiness.update(Object.assign(state, changes), nowS), readiness.network]);
}
return events;
"""
LOADING, IDLE = 2, 1
STEPS: list[tuple[float, dict[str, object], list[object]]] = [
    (0.1, {"receivedBytes": 1000}, ["progress", LOADING]),
    (0.2, {"receivedBytes": 2000, "isShown": True}, ["loadeddata", LOADING]),  # too soon after 0.1
    (0.5, {"receivedBytes": 3000, "endFrame": 5}, ["progress", LOADING]),
    (0.6, {"waiting": False}, ["canplay", "playing", LOADING]),
    (1.2, {"frame": 4, "waiting": True}, ["timeupdate", "waiting", LOADING]),
    (3.4, {}, [LOADING]),
    (3.6, {}, ["stalled", LOADING]),
    (9.0, {}, [LOADING]),
    (
        9.1,
        {"receivedBytes": 4000, "endFrame": 30, "waiting": False},
        ["progress", "canplay", "playing", 2],
    ),
    (9.2, {"receivedBytes": 5000, "endFrame": 70}, ["canplaythrough", LOADING]),
    (9.8, {}, ["progress", "suspend", IDLE]),
    (9.9, {"isSeeking": True}, ["timeupdate", "waiting", IDLE]),
    (10.0, {"isSeeking": False, "playing": False}, ["canplay", "canplaythrough", IDLE]),
]


def test_loading_is_reported_as_the_standard_has_it(page: Page, host: str) -> None:
    """A transcript: a slow start, a stall, enough, and a seek."""
    page.open(f"{host}/empty.html")
    started, opened, *found = page.run(TRANSCRIPT, [step[:2] for step in STEPS])
    assert [started, opened] == [["loadstart"], ["loadedmetadata"]]
    for (now_s, _, expected), events in zip(STEPS, found, strict=True):
        assert events == expected, now_s


OVER_PICTURE = """
const { shadowRoot } = player;
const how = { visibilityProperty: true };
const shows = (name) => shadowRoot.querySelector(name).checkVisibility(how);
return [".ring", ".large", ".bar"].filter(shows);
"""


@pytest.mark.parametrize("preload", ["none", "metadata"])
def test_where_nothing_loads_the_viewer_may_play(page: Page, host: str, preload: str) -> None:
    """The page shows the large button, and no ring that turns forever."""
    page.open(f"{host}/empty.html", 480, 320)
    page.run(MAKE, {"src": "stream", "preload": preload})
    page.wait("player.networkState === 1")
    page.run("return new Promise((resolve) => setTimeout(resolve, 1200))")
    assert page.run(OVER_PICTURE) == [".large", ".bar"]
    page.click(".large")
    page.wait("player.currentTime > 0.1")
    assert page.run(OVER_PICTURE) == [".bar"]


def test_what_loads_for_long_has_a_ring(page: Page, host: str) -> None:
    """The ring shows alone, after a moment; a start without delay never shows it."""
    page.open(f"{host}/empty.html", 480, 320)
    hang = "Worker.prototype.postMessage = () => {}"  # nothing is requested
    page.run(f"{hang}; {MAKE}", {"src": "stream"})
    assert page.run(OVER_PICTURE) == []
    page.run("return new Promise((resolve) => setTimeout(resolve, 1200))")
    assert page.run(OVER_PICTURE) == [".ring"]


def test_workers_start_before_the_page_is_drawn(page: Page, host: str) -> None:
    """In view, they do not wait for the browser's first picture; below the fold none starts."""
    page.open(f"{host}/empty.html", 480, 320)
    make, _, _ = MAKE.partition("return [")
    make += "return player.player.workers !== null;"
    assert page.run(make, {"src": "stream"})
    page.run("player.remove(); document.body.innerHTML = '<div style=\"height: 2000px\"></div>'")
    assert not page.run(make, {"src": "stream"})


def test_frames_are_reported_after_they_were_drawn(page: Page, host: str) -> None:
    """`requestVideoFrameCallback`: the pixels on the canvas are those of the frame named."""
    page.open(f"{host}/empty.html", 200, 150)
    page.run(MAKE, {"src": "stream", "preload": "none"})
    assert page.run("return heard") == ["loadstart", "suspend"]
    script = """
    const seen = [];
    const cancelled = player.requestVideoFrameCallback(() => seen.push("cancelled"));
    player.cancelVideoFrameCallback(cancelled);
    const next = () => new Promise((resolve) =>
      player.requestVideoFrameCallback((nowMs, metadata) => {
        const { canvas, shownFrame } = player.player;
        const context = new OffscreenCanvas(184, 104).getContext("2d");
        context.drawImage(canvas, 0, 0);
        const { data } = context.getImageData(0, 0, 184, 104);
        const lit = data.some((value, i) => i % 4 < 3 && value > 50);
        resolve({ ...metadata, shownFrame, lit, picture: data.join() });
      }));
    player.play();
    for (let n = 0; n < 3; n++) seen.push(await next());
    return seen;
    """
    seen = page.run(script)
    assert [frame["presentedFrames"] for frame in seen] == [1, 2, 3]
    assert [frame["lit"] for frame in seen] == [True, True, True]
    assert len({frame["picture"] for frame in seen}) == 3
    times = [frame["mediaTime"] for frame in seen]
    assert times == sorted(set(times))
    assert times == [frame["shownFrame"] / 30 for frame in seen]
    assert {(frame["width"], frame["height"]) for frame in seen} == {(184, 104)}


CHROME = """
await Promise.all([import("/npm/media-chrome/dist/index.js"),
  import("/web/element/swingsplayer.js")]);
document.body.innerHTML = `<media-controller style="display: block">
  <swings-player slot="media" src="stream"></swings-player>
  <media-control-bar>
    <media-play-button></media-play-button>
    <media-time-range></media-time-range>
    <media-time-display showduration></media-time-display>
    <media-playback-rate-button rates="1 0.5"></media-playback-rate-button>
    <media-pip-button></media-pip-button>
  </media-control-bar>
</media-controller>`;
window.player = document.querySelector("swings-player");
"""


SHOWN_TIME = "return document.querySelector('media-time-display').shadowRoot.textContent"
DRAG_TO = """
const { range } = document.querySelector("media-time-range");
range.value = value;
range.dispatchEvent(new Event("input", { bubbles: true, composed: true }));
"""


def test_media_chrome_binds_to_it(page: Page, host: str, tmp_path: Path) -> None:
    """Controls that are independent of swings can play, seek, show times and set the rate."""
    page.open(f"{host}/empty.html", 640, 480)
    page.run(CHROME)
    page.wait("player.readyState === 4", 30)
    controller = "document.querySelector('media-controller')"
    page.wait(f"{controller}.getAttribute('mediaduration') === '1.5'")
    page.wait(f"{controller}.getAttribute('mediabuffered')?.startsWith('0:')")
    assert "0:01" in page.run(SHOWN_TIME)
    page.click("media-playback-rate-button")
    page.wait("player.playbackRate === 0.5")
    page.click("media-play-button")
    page.wait("!player.paused && player.currentTime > 0.2", 30)
    page.wait(f"!{controller}.hasAttribute('mediapaused')")
    page.screenshot(tmp_path / "chrome.png")
    page.click("media-play-button")
    page.wait("player.paused")
    page.run(DRAG_TO, 0.8)
    page.wait("!player.seeking && player.currentTime === 1.2")
    # The picture below the controls still takes gestures.
    page.drag((200, 100), (260, 120))
    page.wait("player.view !== '0,0,1,0,0'")
    assert not page.complaints


CAPTURE = """
const video = document.createElement("video");
video.muted = true;
const stream = player.captureStream(30);
video.srcObject = stream;
player.loop = true;
await Promise.all([video.play(), player.play()]);
const canvas = new OffscreenCanvas(40, 30);
const context = canvas.getContext("2d", { willReadFrequently: true });
const pictures = new Set();
const endMs = performance.now() + 15000;
while (pictures.size < 3 && performance.now() < endMs) {
  await new Promise((resolve) => video.requestVideoFrameCallback(resolve));
  context.drawImage(video, 0, 0, 40, 30);
  const { data } = context.getImageData(0, 0, 40, 30);
  if (data.some((value, i) => i % 4 < 3 && value > 50)) pictures.add(data.join());
}
const during = [numHolds, video.videoWidth, pictures.size];
for (const track of stream.getTracks()) track.stop();
await new Promise((resolve) => setTimeout(resolve, 300));
return [...during, numHolds];
"""


def test_its_pictures_are_a_stream_of_video(page: Page, host: str) -> None:
    """`captureStream`: a video element plays the canvas until its track is stopped."""
    page.open(f"{host}/empty.html", 200, 150)
    page.run(MAKE, {"src": "stream"})
    page.wait("player.readyState >= 3", 30)
    assert page.run(CAPTURE) == [1, 184, 3, 0]


PIP = """
document.body.insertAdjacentHTML("afterbegin", "<button id=pip>PiP</button>");
window.entered = [];
for (const type of ["enterpictureinpicture", "leavepictureinpicture"]) {
  player.addEventListener(type, () => entered.push(type));
}
document.querySelector("#pip").addEventListener("click", () => {
  player.requestPictureInPicture().then(
    (window_) => (window.opened = window_.width > 0),
    (error) => (window.opened = `${error.name}: ${error.message}`),
  );
});
"""


def test_picture_in_picture(page: Page, host: str) -> None:
    """A window above all others shows the player, and leaves nothing behind."""
    page.open(f"{host}/empty.html", 400, 300)
    page.run(MAKE, {"src": "stream", "loop": ""})
    page.wait("player.readyState >= 3", 30)
    page.run(PIP)
    page.click("#pip")
    page.wait("window.opened !== undefined", 10)
    assert page.run("return window.opened") is True
    assert page.run("return document.pictureInPictureElement === player")
    assert page.run("return numHolds") == 1
    page.run("await document.exitPictureInPicture()")
    page.wait("entered.length === 2")
    assert page.run("return entered") == ["enterpictureinpicture", "leavepictureinpicture"]
    assert page.run("return player.paused")
    page.wait("numHolds === 0")
    assert page.run("return player.shadowRoot.querySelector('video')") is None
