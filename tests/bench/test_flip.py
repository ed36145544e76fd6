"""FLIP beside PSNR: both get worse with the picture, camera by camera."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from bench.flip import FlipConfig, flip_map, scored, table
from tests.bench.scored_stream import FRAMES, NEAR, write_scored
from trainer.score.evaluate import EvaluateConfig, evaluate_stream


def test_flip_tells_no_difference_from_the_largest() -> None:
    black, white = np.zeros((20, 30, 3), np.float32), np.ones((20, 30, 3), np.float32)
    assert flip_map(black, black).shape == (20, 30)
    assert flip_map(black, black).max() == 0
    assert flip_map(black, white).min() > 0.8
    slightly = flip_map(black, black + np.float32(0.05)).mean()
    assert 0 < slightly < flip_map(black, black + np.float32(0.2)).mean()


def test_a_camera_has_its_own_near_plane(tmp_path: Path) -> None:
    every, own, none = (
        scored(FlipConfig(*write_scored(tmp_path / name, **changes), every=3))
        for name, changes in NEAR.items()
    )
    assert own == every
    assert own != none


def test_a_stream_is_scored(tmp_path: Path) -> None:
    stream, capture = write_scored(tmp_path)
    found = scored(FlipConfig(stream, capture))
    psnr_db, flip, moving_db, moving_flip = found["cam01"]
    expected = evaluate_stream(EvaluateConfig(stream, capture)).layers[-1]
    assert np.mean(psnr_db) == pytest.approx(expected.psnr_db, abs=1e-3)
    assert len(flip) == FRAMES
    assert all(0 < value < 1 for value in flip)
    assert len(moving_db) == len(moving_flip)
    if expected.moving_psnr_db is not None:
        assert np.mean(moving_db) == pytest.approx(expected.moving_psnr_db, abs=1e-3)
    console = Console(width=80)
    with console.capture() as shown:
        console.print(table(found))
    assert f"{np.mean(flip):.4f}" in shown.get()
