"""Motion between frames in the browser: which Gaussians go on, and when it is shown."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from codec.slots.slotdecoder import SlotDecoder
from codec.tools.static import export_static
from player.render.moves import ENTERS, MOVES
from tests.support.commands import ROOT
from tests.support.hosted_streams import static_host
from tests.support.slots.moving_updates import moving_updates, write_moving_stream
from tests.support.slots.plain import encoded_chunks
from tests.support.slots.updates import patternless_updates, small_layout
from tests.support.web.browsercode import BrowserCode, BrowserSlots
from tests.support.web.canvas import ELEMENT, PIXELS, PLAYER
from tests.support.web.chromium import Page

NUM_FRAMES = 14
LEAST_INTERVALS = 5
"""Number of intervals between pictures after which the screen's rate is known."""
LEFT = 4
"""Flag in the browser's table of moves: the slot held another Gaussian before."""


@pytest.mark.parametrize("kind", ["moving", "without a pattern", "of two lanes", "passing"])
def test_which_go_on(browser: BrowserCode, kind: str) -> None:
    """The same Gaussians go on as in the package."""
    plain = small_layout(2 if kind == "of two lanes" else 1, (60, 40), 0, 4)
    layout = small_layout(1, (60, 40), 0, 4, 2) if kind == "passing" else plain
    make = moving_updates if kind in ("moving", "passing") else patternless_updates
    chunks = encoded_chunks(layout, list(make(plain, NUM_FRAMES)))
    ours, theirs = SlotDecoder(layout), BrowserSlots(browser, layout)
    for snapshot in chunks.snapshots[0]:
        ours.load(snapshot)
        theirs.load(snapshot)
    seen = set()
    for birth in range(1, NUM_FRAMES):
        mask, changes = chunks.masks[birth], chunks.changes[birth]
        slice = ours.apply(birth, mask, changes, with_motion=True)
        rows = theirs.apply(birth, mask, changes)
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


@given(
    st.floats(0.1, 2),
    st.sampled_from([24.0, 30.0, 60.0]),
    st.integers(1, 300),
    st.integers(0, 3),
    st.floats(0, 1.5),
    st.data(),
)
@settings(max_examples=60, deadline=None)
def test_the_share_of_the_way(
    browser: BrowserCode,
    rate: float,
    fps: float,
    num_frames: int,
    rounds: int,
    way: float,
    data: st.DataObject,
) -> None:
    """The share grows from 0 to 1 between the due times of two frames, in any round."""
    frame = data.draw(st.integers(0, num_frames - 1))
    if num_frames < 4:
        way = min(way, 0.7 * num_frames)
    line = {"zeroMs": 1e12, "rate": rate}
    now_ms = 1e12 + 1000 * (rounds * num_frames + frame + way) / (fps * rate)
    question = {"line": line, "fps": fps, "numFrames": num_frames}
    [found] = browser.ask("shares", moments=[[now_ms, frame]], **question)
    assert found == pytest.approx(min(way, 1), abs=0.02)


def test_nothing_is_on_its_way_while_nothing_runs(browser: BrowserCode) -> None:
    line = {"zeroMs": None, "rate": 1}
    assert browser.ask("shares", line=line, fps=30, numFrames=9, moments=[[5, 1]]) == [1]


@pytest.mark.parametrize("screen_hz", [50, 60, 90, 120, 144])
def test_a_screen_that_is_faster(browser: BrowserCode, screen_hz: int) -> None:
    found = smoothed(browser, screen_hz, 30)
    assert all(one["isMoving"] for one in found[LEAST_INTERVALS:])
    shares = [one["share"] for one in found[screen_hz // 10 :]]
    assert len({round(share, 2) for share in shares}) > 1
    assert 0.2 < np.mean(shares) < 0.7


@pytest.mark.parametrize(("screen_hz", "fps"), [(60, 60), (30, 30), (60, 59.94), (50, 60)])
def test_a_screen_that_is_not(browser: BrowserCode, screen_hz: float, fps: float) -> None:
    """Each frame is drawn unchanged, also while the screen is measured from time to time by a few
    pictures."""
    found = smoothed(browser, screen_hz, fps, count=400)
    assert not any(one["isMoving"] or one["draws"] or one["share"] < 1 for one in found)
    assert 2 * LEAST_INTERVALS <= sum(one["isAsked"] for one in found) <= 25


@given(st.integers(20, 200), st.integers(1, 100), st.sampled_from([3.0, 24.0, 30.0]))
@settings(max_examples=30, deadline=None)
def test_a_pause(browser: BrowserCode, first: int, count: int, fps: float) -> None:
    """A paused player shows an exact frame, and later pictures never go back behind it."""
    found = smoothed(browser, 60, fps, paused=(first, first + count))
    assert all(one["share"] == 1 for one in found[first : first + count])
    for one, after in pairwise(found):
        assert after["frame"] > one["frame"] or after["share"] >= one["share"]
    last = found[first + count - 1]["frame"]
    later = [one["share"] for one in found[first + count :] if one["frame"] > last]
    assert not later or min(later) < 0.6


def test_nothing_is_drawn_anew_where_nothing_moves(browser: BrowserCode) -> None:
    assert not any(one["draws"] for one in smoothed(browser, 120, 30, moves=False))


def test_a_page_that_is_busy_for_a_while(browser: BrowserCode) -> None:
    """The page counts as slow, and is measured again once it is no longer busy."""
    busy_ms = [50.0] * 30 + [0.0] * 400
    found = smoothed(browser, 60, 30, busy_ms, count=400)
    moving = [one["isMoving"] for one in found]
    assert not all(moving[:40])
    assert all(moving[-100:])


def test_the_switch(browser: BrowserCode) -> None:
    found = smoothed(browser, 120, 30, interpolates=False)
    assert not any(one["isMoving"] or one["draws"] for one in found)


def smoothed(
    browser: BrowserCode,
    screen_hz: float,
    fps: float,
    busy_ms: list[float] | None = None,
    count: int = 300,
    interpolates: bool = True,
    paused: tuple[int, int] = (-1, -1),
    moves: bool = True,
) -> list[dict[str, float]]:
    """The shown pictures. paused: the first one in the pause, and the first one after it. moves:
    whether anything moves."""
    question = {"screenHz": screen_hz, "fps": fps, "count": count, "interpolates": interpolates}
    busy = busy_ms or [0.0]
    found: list[dict[str, float]] = browser.ask(
        "smoothed", busyMs=busy, paused=paused, moves=moves, **question
    )
    return found


SEEN = f"""
const {{ view }} = {PLAYER};
const seen = [];
await new Promise((resolve) => {{
  const look = () => {{
    const share = view.painter.renderer.inbetween?.share ?? 1;
    seen.push([view.shownFrame, share, window.shownPixels({PLAYER}.canvas).pixels]);
    if (seen.length < value) requestAnimationFrame(look);
    else resolve();
  }};
  requestAnimationFrame(look);
}});
const names = new Map();
return seen.map(([frame, share, pixels]) => {{
  if (!names.has(pixels)) names.set(pixels, names.size);
  return [frame, share, names.get(pixels)];
}});
"""
"""Frame, share and number of the picture that the canvas shows, refresh after refresh."""


def test_slow_motion_in_a_page(page: Page, tmp_path: Path) -> None:
    """At a tenth of the rate there are many pictures of each frame; the key B ends that, and a
    paused player shows an exact frame."""
    layout = small_layout(1, (60, 40), 0, 5)
    write_moving_stream(tmp_path / "stream", 60, layout)
    export_static(tmp_path / "stream", tmp_path / "static")
    (tmp_path / "player").symlink_to(ROOT / "player")
    with static_host(tmp_path) as url:
        source = f"{url}/player/web/watch.html?src=/static&autoplay=0"
        page.open(source, 160, 120, scripts=[PIXELS])
        page.wait(f"{PLAYER}?.shownFrame >= 0", 60)
        page.run(f"{ELEMENT}.playbackRate = 0.1; {ELEMENT}.play()")
        page.wait(f"{PLAYER}.view.smoothing?.isMoving && {PLAYER}.shownFrame > 1", 60)
        seen = page.run(SEEN, 60)
        by_frame: dict[int, list[tuple[float, int]]] = {}
        for frame, share, number in seen:
            by_frame.setdefault(frame, []).append((share, number))
        ways = list(by_frame.values())[1:-1]
        assert ways
        for way in ways:
            shares = [share for share, _ in way]
            assert shares == sorted(shares)
            assert len({number for _, number in way}) > len(way) / 2
        page.press("b")
        assert page.run(f"return {ELEMENT}.interpolate") is False
        page.wait(f"!{PLAYER}.view.smoothing.isMoving")
        numbers: dict[int, set[int]] = {}
        for frame, share, number in page.run(SEEN, 40):
            assert share == 1
            numbers.setdefault(frame, set()).add(number)
        assert all(len(found) <= 2 for found in numbers.values())
        page.press("b")
        page.wait(f"{PLAYER}.view.smoothing.isMoving")
        page.run(f"{ELEMENT}.pause()")
        page.wait(f"!{PLAYER}.view.smoothing.isMoving && {PLAYER}.isSettled")
        assert page.run(f"return {PLAYER}.renderer.inbetween.share") == 1
        assert not page.complaints
