"""What a red thing leaves behind is found where it was, and measured against its surroundings."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from bench.ghost import GhostConfig, excess, excesses, left_pixels, table
from tests.bench.scored_stream import write_scored

RED = np.array([0.8, 0.4, 0.2], np.float32)
GREY = np.array([0.4, 0.4, 0.4], np.float32)


def with_ball(column: int) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
    """(40, 60, 3) a red square of 10 pixels on grey."""
    picture = np.tile(GREY, (40, 60, 1))
    picture[15:25, column : column + 10] = RED
    return picture


def test_a_ghost_is_found_where_the_ball_was() -> None:
    before, now = with_ball(10), with_ball(18)
    left = left_pixels(before, now, (before != now).any(axis=2))
    rows, columns = np.nonzero(left)
    # The edge of where it is now, four pixels, is left out.
    assert (rows.min(), rows.max(), columns.min(), columns.max()) == (15, 24, 10, 13)
    assert np.abs(excess(now, left, now)).max() < 1e-6
    rendered = now.copy()
    rendered[18, 12] = GREY + np.float32(0.3) * (RED - GREY)  # three tenths of the ball remain
    over = excess(rendered, left, now)
    assert over.max() == pytest.approx(0.3 * 0.5, abs=1e-6)
    assert (over > 12 / 255).sum() == 1


def test_a_thing_that_stands_has_left_nothing() -> None:
    before = with_ball(10)
    assert not left_pixels(before, before, np.zeros((40, 60), np.bool_)).any()
    assert not left_pixels(with_ball(30)[:, ::-1], before, np.zeros((40, 60), np.bool_)).any()


def test_a_stream_is_searched_and_drawn(tmp_path: Path) -> None:
    stream, capture = write_scored(tmp_path)
    for _, shown, truth in excesses(GhostConfig(stream, capture)):
        assert shown.shape == truth.shape
    values = np.array([0.0, 0.1, 0.02], np.float32)
    console = Console(width=120)
    with console.capture() as shown_text:
        console.print(table({"cam01": (values, values * np.float32(0.5))}))
    assert "25.5" in shown_text.get()
