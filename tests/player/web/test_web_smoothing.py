"""Motion between frames in the browser: which Gaussians go on, and when it is shown."""

from __future__ import annotations

from pathlib import Path

import pytest

from codec.slots.decoder import SlotDecoder
from codec.tools.static import export_static
from player.render.upload import ENTERS, MOVES
from tests.support.slots.moving_updates import moving_updates, write_moving_stream
from tests.support.slots.plain import encoded_chunks
from tests.support.slots.updates import patternless_updates, small_layout
from tests.support.web.browsercode import BrowserCode, BrowserSlots
from tests.support.web.chromium import Page
from tests.support.web.site import player_host, watch

NUM_FRAMES = 14
LEFT = 4
"""Flag in the browser's table of moves: the slot held another Gaussian before."""


@pytest.mark.parametrize("kind", ["moving", "without a pattern", "of two lanes"])
def test_which_go_on(browser: BrowserCode, kind: str) -> None:
    """The same Gaussians go on as in the package."""
    layout = small_layout(2 if kind == "of two lanes" else 1, (60, 40), 0, 4)
    make = moving_updates if kind == "moving" else patternless_updates
    chunks = encoded_chunks(layout, list(make(layout, NUM_FRAMES)))
    ours, theirs = SlotDecoder(layout), BrowserSlots(browser, layout)
    for keyframe in chunks.keyframes[0]:
        ours.load(keyframe)
        theirs.load(keyframe)
    seen = set()
    for birth in range(1, NUM_FRAMES):
        skip_map, changes = chunks.skip_maps[birth], chunks.changes[birth]
        slice = ours.apply(birth, skip_map, changes, with_motion=True)
        rows = theirs.apply(birth, skip_map, changes)
        motion = slice.motion
        assert motion is not None
        expected = dict.fromkeys(rows, 0)
        for row, enters in zip(motion.rows.tolist(), motion.enters, strict=True):
            expected[row] = ENTERS if enters else MOVES
        for row in motion.left.tolist():
            expected[row] |= LEFT
        assert theirs.moves == list(expected.values())
        seen |= set(theirs.moves)
    assert {MOVES, ENTERS, LEFT, ENTERS | LEFT} <= seen


SEEN = """
const { view } = player;
const seen = [];
await new Promise((resolve) => {
  const look = () => {
    const share = view.painter.renderer.inbetween?.share ?? 1;
    seen.push([view.shownFrame, share, window.shownPixels(player.canvas).pixels]);
    if (seen.length < value) requestAnimationFrame(look);
    else resolve();
  };
  requestAnimationFrame(look);
});
const names = new Map();
return seen.map(([frame, share, pixels]) => {
  if (!names.has(pixels)) names.set(pixels, names.size);
  return [frame, share, names.get(pixels)];
});
"""
"""Frame, share and number of the picture that the canvas shows, refresh after refresh."""


def test_slow_motion_in_a_page(page: Page, tmp_path: Path) -> None:
    """At a tenth of the rate there are many pictures of each frame; the key B ends that, and a
    paused player shows an exact frame."""
    write_moving_stream(tmp_path / "stream", 60, small_layout(1, (60, 40), 0, 5))
    export_static(tmp_path / "stream", tmp_path / "static")
    with player_host(tmp_path) as url:
        watch(page, f"{url}/player/watch.html?src=/static&autoplay=0")
        page.run("element.playbackRate = 0.1; element.play()")
        page.wait("player.view.smoothing.isMoving && player.shownFrame > 1")
        by_frame: dict[int, list[tuple[float, int]]] = {}
        for frame, share, number in page.run(SEEN, 60):
            by_frame.setdefault(frame, []).append((share, number))
        ways = list(by_frame.values())[1:-1]
        assert ways
        for way in ways:
            shares = [share for share, _ in way]
            assert shares == sorted(shares)
            assert len({number for _, number in way}) > len(way) / 2
        page.press("b")
        assert page.value("element.interpolate") is False
        page.wait("!player.view.smoothing.isMoving")
        page.press("b")
        page.wait("player.view.smoothing.isMoving")
        page.run("element.pause()")
        page.wait("!player.view.smoothing.isMoving && player.isSettled")
        assert page.value("player.renderer.inbetween.share") == 1
