"""bench ghost finds the pixels that a red thing has left, and what remains of it there."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from bench.ghost import GhostConfig, excess, excesses, left_and_around, run, table
from tests.bench.scored_stream import FRAMES, write_scored
from trainer.capture.layout import open_capture

RED = np.array([0.8, 0.4, 0.2], np.float32)
GREY = np.array([0.4, 0.4, 0.4], np.float32)


def with_ball(column: int) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
    """(40, 60, 3) a red square of 10 pixels on grey."""
    picture = np.tile(GREY, (40, 60, 1))
    picture[15:25, column : column + 10] = RED
    return picture


def test_a_ghost_is_found_where_the_ball_was() -> None:
    before, now = with_ball(10), with_ball(18)
    left, ring = left_and_around(before, now, (before != now).any(axis=2), None)
    rows, columns = np.nonzero(left)
    # The edge of where it is now, four pixels, is left out.
    assert (rows.min(), rows.max(), columns.min(), columns.max()) == (15, 24, 10, 13)
    assert np.abs(excess(now, left, ring)).max() < 1e-6
    rendered = now.copy()
    rendered[18, 12] = GREY + np.float32(0.3) * (RED - GREY)  # three tenths of the ball remain
    over = excess(rendered, left, ring)
    assert over.max() == pytest.approx(0.3 * 0.5, abs=1e-6)
    assert (over > 12 / 255).sum() == 1


def test_a_thing_that_stands_has_left_nothing() -> None:
    ball, everything = with_ball(10), np.ones((40, 60), np.bool_)
    left, ring = left_and_around(ball, ball, everything, None)
    assert not left.any()
    assert not ring.any()


def test_ignored_pixels_are_not_around_it() -> None:
    mask = np.ones((40, 60), np.uint8)
    mask[:15] = 0
    _, ring = left_and_around(with_ball(10), with_ball(40), np.ones((40, 60), np.bool_), mask)
    assert ring.any()
    assert not ring[:15].any()


def test_a_stream_is_searched_and_drawn(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    config = GhostConfig(*write_scored(tmp_path))
    run(config)
    assert "no red thing" in capsys.readouterr().out
    # Nothing red moves in this capture: its upper half stands for what a thing has left.
    camera = open_capture(config.capture).cameras[1].camera
    upper = np.zeros((camera.height_px, camera.width_px), np.bool_)
    upper[: len(upper) // 2] = True
    monkeypatch.setattr("bench.ghost.left_and_around", lambda *_: (upper, ~upper))
    monkeypatch.setattr("bench.ghost.MIN_LEFT_PX", 1)
    found = list(excesses(config))
    assert len(found) == FRAMES - 1
    assert all(len(shown) == len(truth) == upper.sum() for _, shown, truth in found)
    values = np.array([0.0, 0.1, 0.02], np.float32)
    console = Console(width=120)
    with console.capture() as shown_text:
        console.print(table({"cam01": (values, values * np.float32(0.5))}))
    assert "25.5" in shown_text.get()
