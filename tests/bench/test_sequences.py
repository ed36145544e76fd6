"""scripts/bench sequences measures the promised figures."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bench.sequences import SequencesConfig, measure, rotating, run, still, walking
from codec.errors import InvalidError
from codec.interop.formats import SplatFormat, encode_splats


def test_a_still_model_costs_its_first_frame(tmp_path: Path) -> None:
    outcome = measure(still(300), 20, tmp_path)
    assert outcome.made.num_frames == 20
    assert outcome.made.played_bytes - outcome.made.first_bytes < 200
    assert outcome.files_bytes[SplatFormat.PLY] == len(
        encode_splats(still(300)(0), SplatFormat.PLY)
    )
    assert len(outcome.made.scores_db[0]) == 4


def test_the_sequences_are_what_they_are_called() -> None:
    turning, shuffled = rotating(50), rotating(50, True)
    assert not np.allclose(turning(0).means, turning(9).means, atol=0.01)
    first, later = (np.hypot(*turning(n).means[:, ::2].T) for n in (0, 9))
    assert np.allclose(first, later, atol=1e-5)
    assert np.allclose(np.sort(turning(3).means, axis=0), np.sort(shuffled(3).means, axis=0))
    assert not np.allclose(turning(3).means, shuffled(3).means)
    calm, noisy = walking(50), walking(50, True)
    assert (calm(5).means != calm(0).means).any(axis=1).sum() == 10
    assert (noisy(5).means != noisy(0).means).any(axis=1).all()


def test_the_table_has_a_row_for_each(capsys: pytest.CaptureFixture[str]) -> None:
    run(SequencesConfig(still_gs=200, still_frames=3, moving_gs=150, frames=3))
    told = capsys.readouterr().out
    for name in (
        "still, 200 x 3",
        "rotating figure, 150 x 3",
        "noise in all x 3",
        ".spz",
        ".sog",
        "mm",
    ):
        assert name in told
    with pytest.raises(InvalidError, match="at least one"):
        SequencesConfig(frames=0)
