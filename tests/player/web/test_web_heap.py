"""Memory does not grow with what has been played."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from codec.tools.static import export_static
from tests.support.hosted_streams import static_host, write_stream
from tests.support.slots.slot_streams import write_busy_stream
from tests.support.slots.updates import small_layout
from tests.support.web.chromium import Page

ROOT = Path(__file__).parents[3]
PLAYER = "document.querySelector('swings-player').player"
PLAY_UNTIL = """
const { player } = document.querySelector("swings-player");
let [played, last] = [window.played ?? 0, player.state.frame];
await new Promise((resolve) => {
  const look = () => {
    const { frame } = player.state;
    played += frame - last + (frame < last ? player.numFrames : 0);
    last = frame;
    if (played < value) return;
    player.removeEventListener("state", look);
    resolve();
  };
  player.addEventListener("state", look);
  player.setPlaying(true);
});
window.played = played;
player.setPlaying(false);
"""
"""Plays on until `value` frames have been played in all."""


@contextmanager
def opened(page: Page, folder: Path, rate: int, buffer_mb: float) -> Iterator[Page]:
    """The page, paused at the first frame of the stream in `folder`."""
    export_static(folder / "stream", folder / "static")
    (folder / "web").symlink_to(ROOT / "player" / "web")
    with static_host(folder) as url:
        page.open(f"{url}/web/watch.html?src=../static&autoplay=0&buffer-mb={buffer_mb}", 160, 120)
        page.wait(f"{PLAYER}?.shownFrame >= 0", 60)
        page.run(f"{PLAYER}.setRate({rate})")
        yield page
        assert not page.complaints


def growth_bytes(page: Page, frames: tuple[int, int], lead_frames: int) -> int:
    """Of that which grew most, the page or one of its workers, from the first to the second number
    of frames played. lead_frames: of the stream, that are there before anything is counted."""
    found: list[list[int]] = []
    for frame in frames:
        page.run(PLAY_UNTIL, frame)
        page.wait(f"{PLAYER}.state.endFrame - {PLAYER}.state.frame >= {lead_frames}", 300)
        found.append(page.heaps_bytes())
    assert len(found[0]) == 3
    before, after = found
    return max(b - a for a, b in zip(before, after, strict=True))


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_five_thousand_frames(page: Page, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One after another, as fast as they come: what is kept of each frame, picture or object would
    show. It takes 24 bytes a frame for a leak; what V8 and the styles that Blink remembers of the
    track's places gather is 10 to 18, and no object of the player's grows in number.

    Segments are shorter than what is chosen at a time: one that was left out would end the play."""
    monkeypatch.setattr(os, "fsync", lambda fd: None)
    write_stream(tmp_path / "stream", 5600, 10, 0, layers=(1.0,), segment_frames=2)
    less_than_a_thousand_frames_mb = 0.25
    with opened(page, tmp_path, 60, less_than_a_thousand_frames_mb) as playing:
        assert growth_bytes(playing, (1000, 5000), 448) < 24 * 4000


@pytest.mark.slow
def test_a_loop(page: Page, tmp_path: Path) -> None:
    """Forty times from the beginning: a play that is kept takes 38 kB. What has come ahead when
    the heaps are looked at makes 300 kB more or less."""
    write_busy_stream(tmp_path / "stream", 60, small_layout(1, (200, 200, 100), 0, 15))
    with opened(page, tmp_path, 20, 64) as playing:
        assert growth_bytes(playing, (600, 3000), 0) < 40 * 20_000
