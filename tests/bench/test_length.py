"""The verdict on memory and time over the length of a video, its table and its plot."""

from __future__ import annotations

import pytest

from bench.length import Track, complaints

MB = 1_000_000


def test_growth_is_what_is_complained_about() -> None:
    flat = Track([1.0] + [0.05] * 299, [200 * MB] * 300, 201 * MB)
    assert complaints([flat]) == []
    fills = Track(flat.seconds, [100 * MB] * 29 + [200 * MB] * 271, 201 * MB)
    assert complaints([fills]) == []
    grows = Track(flat.seconds, [200 * MB] * 290 + [212 * MB] * 10, 212 * MB)
    slows = Track([1.0] + [0.05] * 249 + [0.06] * 50, flat.memory_bytes, 201 * MB)
    assert complaints([grows, slows]) == [
        "300 frames: memory +6.0%",
        "300 frames: time per frame +20.0%",
    ]
    # A few short frames are too few to judge time, but not memory.
    short = Track([1.0] + [0.05] * 15 + [0.06] * 14, [200 * MB] * 20 + [220 * MB] * 10, 220 * MB)
    assert short.time_growth == pytest.approx(0.2)
    assert complaints([short]) == ["30 frames: memory +10.0%"]
