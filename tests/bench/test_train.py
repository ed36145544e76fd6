"""The training benchmark at its smallest."""

from __future__ import annotations

from bench.train import against_torch, stages, step_at

CASE = (300, 61, 40)


def test_the_measurement_is_complete() -> None:
    found = stages(*CASE, repeats=2)
    parts = ("project", "tile lists", "blend", "loss", "whole backward", "Adam", "noise")
    assert all(found[name] > 0 for name in (*parts, "pairs", "whole step"))
    assert 0 < found["outside rasteriser"] < 100
    some = step_at(0.1, *CASE, repeats=2)
    assert 0 < some.active_percent <= 100
    assert min(some.whole_ms, some.some_tiles_ms) > 0
    ours_ms, torch_ms = against_torch(*CASE, repeats=1)
    assert ours_ms > 0
    assert torch_ms > 0
