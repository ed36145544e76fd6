"""The WebGL context of a page: lost, restored, lost forever, and shared by twenty players."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from codec.stream.reader import StreamReader
from codec.tools.static import export_static
from tests.support.hosted_streams import static_host, write_stream
from tests.support.web.canvas import (
    ELEMENT,
    LEAST_PSNR_DB,
    PIXELS,
    PLAYER,
    STATE,
    canvas_of,
    expected_of,
    picture_of,
    psnr_db,
)
from tests.support.web.chromium import Page

ROOT = Path(__file__).parents[3]
NUM_FRAMES = 60
NUM_PLAYERS = 20
LOSE = f"""
window.extension = {PLAYER}.gl.getExtension("WEBGL_lose_context");
const lost = new Promise((resolve) => {PLAYER}.addEventListener("contextlost", resolve));
extension.loseContext();
await lost;
"""
NOTE = f"{ELEMENT}.shadowRoot.querySelector('.note.soft').textContent"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The player in web/ and a stream in static/."""
    path = tmp_path_factory.mktemp("context")
    write_stream(path / "stream", NUM_FRAMES, slice_size=100, layers=(1.0,))
    export_static(path / "stream", path / "static")
    (path / "web").symlink_to(ROOT / "player" / "web")
    (path / "bare.html").write_text('<!doctype html><link rel="icon" href="data:," />')
    return path


@pytest.fixture
def opened(page: Page, folder: Path, tmp_path: Path) -> Iterator[Page]:
    """The page, paused at the first frame. Its time limits of 10 s last `limitMs` instead."""
    (tmp_path / "clock.js").write_text(
        "const { setTimeout } = window;"
        "window.limitMs = 10000;"
        "window.setTimeout = (action, ms) => setTimeout(action, ms === 10000 ? limitMs : ms);"
    )
    with static_host(folder) as url:
        address = f"{url}/web/watch.html?src=../static&autoplay=0"
        page.open(address, 480, 320, scripts=(tmp_path / "clock.js", PIXELS))
        page.wait(f"{PLAYER}?.shownFrame === 0", 60)
        yield page
        # The browser logs this for a context that a script loses.
        assert all("loseContext" in complaint for complaint in page.complaints)


def test_a_lost_context_keeps_its_picture_and_plays_on(opened: Page) -> None:
    page = opened
    before = canvas_of(page)
    page.run("window.limitMs = 1e6")  # it comes back, even on a slow machine
    page.run(LOSE)
    page.run(f"{PLAYER}.orbit.dragTurn(50, 0); {PLAYER}.moved()")
    page.wait(f"{NOTE}.includes('waiting for it')")
    held = picture_of(page.run(f"return shownPixels({PLAYER}.canvas)"))
    np.testing.assert_array_equal(held, before)
    page.run(f"{PLAYER}.orbit.reset(); extension.restoreContext()")
    page.wait(f"{PLAYER}.renderer?.numDrawn > 0 && {NOTE} === ''")
    np.testing.assert_array_equal(canvas_of(page), before)

    page.run(f"{ELEMENT}.play()")
    page.wait(f"{PLAYER}.shownFrame > 5", 30)
    page.run(LOSE)
    frame = page.run(f"return {PLAYER}.shownFrame")
    assert page.run(f"return {ELEMENT}.paused || {STATE}.playing") is False
    page.run("extension.restoreContext()")
    page.wait(f"{PLAYER}.shownFrame > {frame + 5}", 30)
    assert page.run(f"return {ELEMENT}.error") is None


def test_a_context_that_does_not_come_back(opened: Page) -> None:
    """The player reports it, and a retry draws the same frame with another context."""
    page = opened
    page.run(f"{ELEMENT}.currentTime = 1")
    page.wait(f"{PLAYER}.shownFrame === 30 && !{PLAYER}.isSeeking", 30)
    before = canvas_of(page)
    page.run("window.limitMs = 500")
    page.run(LOSE)
    page.wait(f"{ELEMENT}.error?.message.includes('did not come back')")
    held = picture_of(page.run(f"return shownPixels({PLAYER}.canvas)"))
    np.testing.assert_array_equal(held, before)
    page.run(f"{PLAYER}.retry()")
    page.wait(f"{PLAYER}.renderer?.numDrawn > 0", 30)
    assert page.run(f"return {PLAYER}.shownFrame") == 30
    np.testing.assert_array_equal(canvas_of(page), before)


TWO_ANSWERS = f"""
const player = {PLAYER};
const {{ requestAnimationFrame }} = window;
const block = (ms) => {{
  const endMs = performance.now() + ms;
  while (performance.now() < endMs);
}};
window.requestAnimationFrame = () => 1; // the browser lets nothing draw
player.view.loop.stop();
player.view.isEmpty = true;
player.resend();
block(value); // the sorter answers
player.orbit.dragTurn(5, 0);
player.view.loop.flush(); // asks for another order
block(value); // the sorter answers again
await new Promise((resolve) => setTimeout(resolve, 50)); // both answers arrive
window.requestAnimationFrame = requestAnimationFrame;
player.view.loop.stop();
player.view.redraw();
"""
"""Makes the sorter answer twice before the page draws, after `value` ms each, with all Gaussians in
the first answer."""


def test_two_answers_of_the_sorter_before_a_picture(opened: Page) -> None:
    page = opened
    for block_ms in (20, 50, 100, 200, 400):
        page.wait(f"{PLAYER}.isSettled")
        page.run(TWO_ANSWERS, block_ms)
        page.wait(f"!{PLAYER}.view.isEmpty && {PLAYER}.isSettled")


TWENTY = f"""
await import(new URL("web/element/swingsplayer.js", location.href));
document.body.innerHTML = "";
for (let i = 0; i < {NUM_PLAYERS}; i++) {{
  const player = document.createElement("swings-player");
  player.src = "static";
  player.style = "position: absolute; width: 120px; height: 68px; " +
    `left: ${{125 * (i % 5)}}px; top: ${{72 * Math.floor(i / 5)}}px`;
  document.body.append(player);
}}
"""
EVERY = "[...document.querySelectorAll('swings-player')].every"


@pytest.mark.slow
def test_twenty_players_in_view(page: Page, folder: Path, tmp_path: Path) -> None:
    """All of them play, each shows its picture, and the page has one WebGL context."""
    (tmp_path / "count.js").write_text(
        "window.contexts = new Set();"
        "const { getContext } = HTMLCanvasElement.prototype;"
        "HTMLCanvasElement.prototype.getContext = function (kind, ...rest) {"
        "  const context = getContext.call(this, kind, ...rest);"
        "  if (kind.startsWith('webgl')) window.contexts.add(context);"
        "  return context;"
        "};"
    )
    with static_host(folder) as url:
        page.open(f"{url}/bare.html", 640, 300, scripts=(tmp_path / "count.js", PIXELS))
        page.run(TWENTY)
        page.wait(f"{EVERY}(({{ player }}) => player.shownFrame === 0)", 60)
        assert page.run("return contexts.size") == 1
        pictures = page.run(
            "return Promise.all([...document.querySelectorAll('swings-player')]"
            ".map(({ player }) => readCanvas(player)))"
        )
        reader = StreamReader(folder / "stream")
        expected = expected_of(reader, reader.manifest.camera().fitted(120, 68))
        assert len(pictures) == NUM_PLAYERS
        for picture in pictures:
            assert psnr_db(picture_of(picture), expected) >= LEAST_PSNR_DB
        page.run("for (const one of document.querySelectorAll('swings-player')) one.play()")
        page.wait(f"{EVERY}(({{ player }}) => player.shownFrame > 0)", 60)
        page.screenshot(tmp_path / "twenty.png")
        assert page.run(f"return {EVERY}(({{ error }}) => error === null)")
        assert not page.complaints
