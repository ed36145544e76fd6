"""The combined cost of several cameras for one depth."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trainer.seed.stereo import better_half


@given(st.lists(st.integers(0, 255), min_size=2, max_size=9), st.integers(1, 2))
def test_the_better_half_is_the_lower_one_whatever_the_order(costs: list[int], least: int) -> None:
    spare = np.array([*costs, 0, 0], np.float32)  # values after the costs do not count
    lower = sorted(costs)[: max(least, (len(costs) + 1) // 2)]
    assert better_half(spare, len(costs), least) == pytest.approx(np.mean(lower), rel=1e-6)


@pytest.mark.parametrize(("least", "mean"), [(1, 1.0), (2, 3.0)])
def test_of_two_cameras_one_settles_a_depth_unless_two_are_asked_for(
    least: int, mean: float
) -> None:
    assert better_half(np.array([5.0, 1.0], np.float32), 2, least) == mean
