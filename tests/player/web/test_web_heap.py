"""Memory does not grow with what has been played."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from tests.support.hosted_streams import write_stream
from tests.support.slots.slot_streams import write_busy_stream
from tests.support.slots.updates import small_layout
from tests.support.web.canvas import PLAYER
from tests.support.web.chromium import Page
from tests.support.web.heaps import PLAY_UNTIL, opened

LOOKS = 3


def growth_bytes(page: Page, frames: tuple[int, int], step: int, lead_frames: int) -> int:
    """Of that which grew most, the page or one of its workers, from the first to the second number
    of frames played. At each end the least of three looks counts, `step` frames apart: what is on
    its way at one of them makes up to 200 kB. lead_frames: of the stream, that are there before
    anything is counted."""
    found: list[list[int]] = []
    for frame in (first + look * step for first in frames for look in range(LOOKS)):
        page.run(PLAY_UNTIL, frame)
        page.wait(f"{PLAYER}.state.endFrame - {PLAYER}.state.frame >= {lead_frames}", 300)
        found.append(page.heaps_bytes())
    held = np.array(found).reshape(2, LOOKS, 3).min(axis=1)  # (2, the page and its two workers)
    return int((held[1] - held[0]).max())


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
        assert growth_bytes(playing, (1000, 4000), 500, 448) < 24 * 3000


@pytest.mark.slow
def test_a_loop(page: Page, tmp_path: Path) -> None:
    """Forty times from the beginning: a play that is kept takes 38 kB. What has come ahead when
    the heaps are looked at makes 300 kB more or less."""
    write_busy_stream(tmp_path / "stream", 60, small_layout(1, (200, 200, 100), 0, 15))
    with opened(page, tmp_path, 20, 64) as playing:
        assert growth_bytes(playing, (600, 3000), 60, 0) < 40 * 20_000
