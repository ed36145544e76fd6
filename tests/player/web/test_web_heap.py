"""Memory does not grow with the number of played frames."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from tests.support.hosted_streams import write_stream
from tests.support.slots.slot_streams import write_busy_stream
from tests.support.slots.updates import small_layout
from tests.support.web.chromium import Page
from tests.support.web.heaps import PLAY_UNTIL, opened


def growth_bytes(page: Page, frames: range, lead_frames: int) -> list[float]:
    """Growth of the heaps of the page and its two workers for each frame played, bytes: the median
    of the slopes between all pairs of samples (Theil and Sen's), one sample at each of `frames`.
    Data in transit makes 200 kB and more of a sample, so of nine samples two may be far off.
    lead_frames: frames that must be buffered before a sample is taken."""
    found: list[list[int]] = []
    for frame in frames:
        page.run(PLAY_UNTIL, frame)
        page.wait(f"state.endFrame - state.frame >= {lead_frames}")
        found.append(page.heaps_bytes())
    held = np.array(found)  # (looks, the page and its two workers)
    first, second = np.triu_indices(len(frames), 1)
    slopes = (held[second] - held[first]) / (frames.step * (second - first))[:, None]
    return [float(slope) for slope in np.median(slopes, axis=0)]


@pytest.mark.deep
@pytest.mark.timeout(1200)
def test_five_thousand_frames(page: Page, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The frames play as fast as they arrive, so that anything kept for each frame, picture or
    object shows. 24 bytes per frame count as a leak. V8, and the styles of the track's places that
    Blink keeps, gather 10 to 18; no object of the player grows in number.

    Segments are shorter than the unit of a choice, so that an omitted one would end the play."""
    monkeypatch.setattr(os, "fsync", lambda fd: None)
    write_stream(tmp_path / "stream", 5600, 10, 0, layers=(1.0,), segment_frames=2)
    less_than_a_thousand_frames_mb = 0.25
    with opened(page, tmp_path, 60, less_than_a_thousand_frames_mb) as playing:
        found = growth_bytes(playing, range(1000, 5001, 500), 448)
        assert max(found) < 24, found


@pytest.mark.deep
def test_a_loop(page: Page, tmp_path: Path) -> None:
    """The clip plays forty times; a play that is kept takes 38 kB. Data fetched ahead when the
    heaps are read makes a difference of 300 kB."""
    write_busy_stream(tmp_path / "stream", 60, small_layout(1, (200, 200, 100), 0, 15))
    with opened(page, tmp_path, 20, 64) as playing:
        found = growth_bytes(playing, range(600, 3001, 300), 0)
        assert 60 * max(found) < 20_000, found
