"""`<swings-player>` as the media element that other controls and recorders expect."""

from __future__ import annotations

import pytest

from tests.support.web.chromium import Page
from tests.support.web.site import Site

OVER_PICTURE = """[".ring", ".large", ".bar"].filter(
  (name) => part(name)?.checkVisibility({ visibilityProperty: true }),
)"""

MAKE = """
await import("/player/player.js");
const made = document.createElement("swings-player");
window.heard = [];
const events = ["loadstart", "suspend", "durationchange", "loadedmetadata", "loadeddata", "canplay",
  "canplaythrough", "play", "playing", "pause", "seeking", "seeked", "ratechange", "volumechange",
  "emptied", "abort", "ended", "error", "layerschange"];
for (const type of events) made.addEventListener(type, () => heard.push(type));
made.addEventListener("timeupdate", () => (heard.time = made.currentTime));
const before = [made.paused, made.currentTime, Number.isNaN(made.duration), made.view];
for (const [name, text] of Object.entries(value)) made.setAttribute(name, text);
document.body.append(made);
window.numHolds = 0;
made.player.keepAlive = () => {
  numHolds += 1;
  return () => (numHolds -= 1);
};
"""
"""Makes a player with the attributes `value`."""
UNSURE = "canplay", "canplaythrough", "suspend", "waiting"
"""Events whose number depends on the network."""


@pytest.fixture
def empty(page: Page, site: Site) -> Page:
    """A page without a player."""
    page.open(site.write_page("empty.html", ""), 480, 320)
    return page


def heard(page: Page, *but: str) -> list[str]:
    """The events since the last call, except some."""
    return [event for event in page.run("return heard.splice(0)") if event not in but]


def ranges(name: str) -> str:
    """The expression for the ranges of a property, as pairs of seconds."""
    return f"Array.from(element.{name}, (_, i) => [element.{name}.start(i), element.{name}.end(i)])"


OUTCOME = "(promise) => promise.then(() => 'playing', (error) => error.name)"


def test_it_loads_plays_and_ends_as_a_media_element(empty: Page, site: Site) -> None:
    page = empty
    page.expect("404")
    page.run(MAKE, {"src": "clip", "preload": "metadata"})
    page.wait("element.networkState === 1")
    metadata = ["loadstart", "durationchange", "loadedmetadata", "suspend"]
    assert heard(page) == metadata
    # Only the description was fetched.
    assert page.value("[element.readyState, state.receivedBytes]") == [1, 0]
    assert page.value("element.currentSrc") == f"{site.url}/clip"
    assert page.value(f"[{ranges('seekable')}, {ranges('buffered')}]") == [[[0, 1.5]], []]
    assert page.value("[element.videoWidth, element.videoHeight]") == [464, 261]

    page.run("element.playbackRate = 0.5")
    assert page.value(f"({OUTCOME})(element.play())") == "playing"
    page.wait("heard.includes('ended')")
    found = heard(page, "canplaythrough", "suspend")
    assert found[:5] == ["ratechange", "play", "loadeddata", "canplay", "playing"]
    assert found[-2:] == ["pause", "ended"]
    assert set(found[5:-2]) <= {"canplay", "playing"}, "again if it had to wait"
    assert page.value(f"[{ranges('played')}, {ranges('buffered')}.at(-1)[1]]") == [[[0, 1.5]], 1.5]
    page.wait("element.networkState === 1 && element.readyState === 4")
    beyond = "try { element.played.end(1) } catch (e) { return e.name }"
    assert page.run(beyond) == "IndexSizeError"

    page.run("heard.length = 0; element.volume = 0.5; element.muted = true; element.muted = true")
    assert heard(page) == ["volumechange", "volumechange"]
    page.run("element.muted = false; element.defaultMuted = true")
    assert heard(page) == ["volumechange"]
    assert page.value("element.muted") is False, "the attribute has no effect later"
    page.run("element.defaultMuted = false")
    # Promises of play() for which playback never starts.
    paused = f"element.load(); const played = ({OUTCOME})(element.play()); element.pause();"
    assert page.run(f"{paused} return played") == "AbortError"
    page.wait("heard.includes('suspend')")
    begun = ["abort", "emptied", "ratechange", "loadstart", "play", "pause"]
    assert heard(page) == [*begun, *metadata[1:]]
    replaced = f"const played = ({OUTCOME})(element.play()); element.src = 'none';"
    failing = f"return [await played, await ({OUTCOME})(element.play())]"
    assert page.run(f"{replaced} {failing}") == ["AbortError", "NotSupportedError"]
    status = "[element.error.code, element.networkState, element.readyState]"
    assert page.value(status) == [4, 3, 0]
    assert page.value(f"({OUTCOME})(element.play())") == "NotSupportedError"
    assert heard(page) == ["play", "abort", "emptied", "loadstart", "play", "error"]


def test_what_a_script_can_do(empty: Page) -> None:
    """The events and properties of seeks, loops, rates and layers."""
    page = empty
    page.expect("404")
    assert page.run(f"{MAKE} return before", {"src": "/clip"}) == [True, 0, True, ""]
    page.wait("player.shownFrame === 0")
    values = "[element.duration, element.numLayers, element.layers, element.view]"
    assert page.value(values) == [1.5, 3, 0, "0,0,1,0,0"]
    page.wait("heard.includes('loadeddata')")
    heard(page)

    sought = "element.currentTime = 1; return [element.seeking, element.currentTime]"
    assert page.run(sought) == [True, 1]
    page.wait("heard.includes('seeked')")
    assert page.value("[element.seeking, player.shownFrame]") == [False, 30]
    assert heard(page, *UNSURE) == ["seeking", "seeked"]

    page.run("element.playbackRate = 0.5; element.layers = 2; element.play()")
    page.wait("element.ended")
    found = heard(page, *UNSURE)
    assert found[:4] == ["ratechange", "layerschange", "play", "playing"]
    assert found[-2:] == ["pause", "ended"]
    assert page.value("[element.paused, element.currentTime, heard.time]") == [True, 1.5, 1.5]

    page.run("element.loop = true; element.play()")
    page.wait("heard.time < 0.5")
    page.run("element.pause()")
    found = heard(page, *UNSURE)
    # The stream has ended: playing starts with a seek to the first frame.
    assert (found[:2], found[-1]) == (["seeking", "play"], "pause")

    page.run("element.removeAttribute('src'); element.load()")
    held = "[player.workers, player.source, element.networkState, element.currentSrc]"
    assert page.value(held) == [None, None, 0, ""]
    page.wait("part('.frame').dataset.condition === 'empty' && heard.includes('emptied')")
    assert page.value(f"({OVER_PICTURE})") == []

    page.run("element.src = '../nothing'")
    page.wait("heard.includes('error')")
    assert "HTTP 404" in page.value("element.error.message")
    for change in "element.playbackRate = 0", "element.flyToCamera(NaN)":
        refused = f"try {{ {change} }} catch (e) {{ return e.name }}"
        assert page.run(refused) == "RangeError"


@pytest.mark.parametrize("preload", ["none", "metadata"])
def test_where_nothing_loads_the_viewer_may_play(empty: Page, preload: str) -> None:
    """The page shows the large button, and no ring that turns forever."""
    page = empty
    page.run(MAKE, {"src": "clip", "preload": preload, "loop": ""})
    page.wait("element.networkState === 1")
    page.run("return new Promise((resolve) => setTimeout(resolve, 1200))")
    page.wait(f"({OVER_PICTURE}).join() === '.large,.bar'")
    page.click(".large")
    move = "element.dispatchEvent(new PointerEvent('pointermove', { bubbles: true }))"
    page.wait(f"{move} && element.currentTime > 0.1 && ({OVER_PICTURE}).join() === '.bar'")


def test_what_loads_for_long_has_a_ring(empty: Page) -> None:
    """The ring shows alone, after a moment; a start without delay never shows it."""
    hang = "Worker.prototype.postMessage = () => {};"  # nothing is requested
    names = OVER_PICTURE.replace("part(", "made.shadowRoot.querySelector(")
    assert empty.run(f"{hang} {MAKE} return {names}", {"src": "clip"}) == []
    empty.wait(f"({OVER_PICTURE}).join() === '.ring'")


def test_workers_start_before_the_page_is_drawn(empty: Page) -> None:
    """In view, they do not wait for the browser's first picture; below the fold none starts."""
    make = f"{MAKE} return made.player.workers !== null;"
    assert empty.run(make, {"src": "clip"})
    empty.run("element.remove(); document.body.innerHTML = '<div style=\"height: 2000px\"></div>'")
    assert not empty.run(make, {"src": "clip"})


PRESENTED = """
const seen = [];
const cancelled = element.requestVideoFrameCallback(() => seen.push("cancelled"));
element.cancelVideoFrameCallback(cancelled);
const next = () => new Promise((resolve) =>
  element.requestVideoFrameCallback((nowMs, metadata) => {
    const { canvas, shownFrame } = player;
    const context = new OffscreenCanvas(canvas.width, canvas.height).getContext("2d");
    context.drawImage(canvas, 0, 0);
    const { data } = context.getImageData(0, 0, canvas.width, canvas.height);
    const lit = data.some((value, i) => i % 4 < 3 && value > 50);
    const isWhole = metadata.width === canvas.width && metadata.height === canvas.height;
    resolve({ ...metadata, shownFrame, lit, isWhole, picture: data.join() });
  }));
element.playbackRate = 0.2;
element.play();
for (let n = 0; n < 3; n++) seen.push(await next());
return seen;
"""


def test_frames_are_reported_after_they_were_drawn(empty: Page) -> None:
    """`requestVideoFrameCallback`: the pixels on the canvas are those of the frame named."""
    empty.run(MAKE, {"src": "clip", "preload": "none"})
    assert empty.value("heard") == ["loadstart", "suspend"]
    seen = empty.run(PRESENTED)
    assert [frame["presentedFrames"] for frame in seen] == [1, 2, 3]
    assert all(frame["lit"] and frame["isWhole"] for frame in seen)
    assert len({frame["picture"] for frame in seen}) == 3
    times = [frame["mediaTime"] for frame in seen]
    assert times == sorted(set(times))
    assert times == [frame["shownFrame"] / 30 for frame in seen]


CHROME = """
await Promise.all([import("/npm/media-chrome/dist/index.js"), import("/player/player.js")]);
document.body.innerHTML = `<media-controller style="display: block">
  <swings-player slot="media" src="clip"></swings-player>
  <media-control-bar>
    <media-play-button></media-play-button>
    <media-time-range></media-time-range>
    <media-time-display showduration></media-time-display>
    <media-playback-rate-button rates="1 0.5"></media-playback-rate-button>
    <media-pip-button></media-pip-button>
  </media-control-bar>
</media-controller>`;
"""
DRAG_TO = """
const { range } = document.querySelector("media-time-range");
range.value = value;
range.dispatchEvent(new Event("input", { bubbles: true, composed: true }));
"""


def test_media_chrome_binds_to_it(empty: Page) -> None:
    """Controls that are independent of swings can play, seek, show times and set the rate."""
    page = empty
    page.run(CHROME)
    page.wait("element.readyState === 4")
    controller = "document.querySelector('media-controller')"
    page.wait(f"{controller}.getAttribute('mediaduration') === '1.5'")
    page.wait(f"{controller}.getAttribute('mediabuffered').startsWith('0:')")
    shown = "document.querySelector('media-time-display').shadowRoot.textContent"
    assert "0:01" in page.value(shown)
    page.click("media-playback-rate-button")
    page.wait("element.playbackRate === 0.5")
    page.click("media-play-button")
    page.wait("element.currentTime > 0.2")
    page.wait(f"!{controller}.hasAttribute('mediapaused')")
    page.click("media-play-button")
    page.wait("element.paused")
    page.run(DRAG_TO, 0.8)
    page.wait("!element.seeking && element.currentTime === 1.2")
    # The picture below the controls still takes gestures.
    page.drag((100, 60), (160, 80))
    page.wait("element.view !== '0,0,1,0,0'")


CAPTURE = """
const video = document.createElement("video");
video.muted = true;
const stream = element.captureStream(30);
video.srcObject = stream;
element.loop = true;
await Promise.all([video.play(), element.play()]);
const canvas = new OffscreenCanvas(40, 30);
const context = canvas.getContext("2d", { willReadFrequently: true });
const pictures = new Set();
while (pictures.size < 3) {
  await new Promise((resolve) => video.requestVideoFrameCallback(resolve));
  context.drawImage(video, 0, 0, 40, 30);
  const { data } = context.getImageData(0, 0, 40, 30);
  if (data.some((value, i) => i % 4 < 3 && value > 50)) pictures.add(data.join());
}
const during = [numHolds, video.videoWidth === player.canvas.width];
for (const track of stream.getTracks()) track.stop();
return during;
"""


def test_its_pictures_are_a_stream_of_video(empty: Page) -> None:
    """`captureStream`: a video element plays the canvas until its track is stopped."""
    empty.run(MAKE, {"src": "clip"})
    empty.wait("element.readyState >= 3")
    assert empty.run(CAPTURE) == [1, True]
    empty.wait("numHolds === 0")


PIP = """
document.body.insertAdjacentHTML("afterbegin", "<button id=pip>PiP</button>");
window.entered = [];
for (const type of ["enterpictureinpicture", "leavepictureinpicture"]) {
  element.addEventListener(type, () => entered.push(type));
}
document.querySelector("#pip").addEventListener("click", () => {
  element.requestPictureInPicture().then(
    (window_) => (window.opened = window_.width > 0),
    (error) => (window.opened = `${error.name}: ${error.message}`),
  );
});
"""


def test_picture_in_picture(empty: Page) -> None:
    """A window above all others shows the player, and leaves nothing behind."""
    page = empty
    page.run(MAKE, {"src": "clip", "loop": ""})
    page.wait("element.readyState >= 3")
    page.run(PIP)
    page.click("#pip")
    page.wait("window.opened !== undefined")
    assert page.value("window.opened") is True
    assert page.value("document.pictureInPictureElement === element")
    assert page.value("numHolds") == 1
    page.run("await document.exitPictureInPicture()")
    page.wait("entered.length === 2 && numHolds === 0")
    assert page.value("entered") == ["enterpictureinpicture", "leavepictureinpicture"]
    assert page.value("element.paused")
    assert page.value("part('video')") is None
