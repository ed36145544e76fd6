"""The training benchmark at its smallest, and that its plain torch step is the step of ours."""

from __future__ import annotations

import numpy as np

from bench.train import (
    DSSIM_WEIGHT,
    MEANS_LR_M,
    NEAR_M,
    Step,
    against_torch,
    bench_camera,
    bench_target,
    scene,
    stages,
    step_at,
)
from tests.support.torch_step import TorchStep
from trainer.fit.optimiser import OptimiserConfig

CASE = (300, 61, 40)


def test_the_torch_step_draws_and_learns_what_ours_does() -> None:
    count, width_px, height_px = CASE
    ours = Step(*CASE)
    theirs = TorchStep(
        scene(count), bench_camera(width_px, height_px), NEAR_M,
        bench_target(width_px, height_px), DSSIM_WEIGHT, OptimiserConfig(), MEANS_LR_M,
    )  # fmt: skip
    expected = theirs.picture().detach().numpy()
    ours.step()
    theirs.step()
    drawn = ours.scratch.take("picture", 3, 48, 64)[:, :height_px, :width_px]
    assert expected.max() > 0.5
    assert float(np.abs(drawn - expected).max()) < 1e-4
    for got, leaf in zip(ours.gradients.arrays, theirs.leaves, strict=True):
        assert leaf.grad is not None
        wanted = leaf.grad.numpy()
        assert float(np.abs(got - wanted).max()) < 5e-3 * float(np.abs(wanted).max())
    # Adam's first step is the sign of a gradient times the rate, so tiny gradients may differ.
    for got, leaf in zip(ours.values.arrays, theirs.leaves, strict=True):
        assert float(np.median(np.abs(got - leaf.detach().numpy()))) < 1e-6


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
