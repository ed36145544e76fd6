"""Corrections of colour find what cameras do, and settle."""

from __future__ import annotations

import numpy as np
import torch

from trainer.step.colour import FULL_STEPS, IDENTITY, CameraColour
from trainer.step.device.tensors import Crossing, TensorColour


def test_corrections_are_found_and_stay_near_identity_where_nothing_tells() -> None:
    """Gradients of squared errors, and noise as large as an error of 0.2. Nothing tells biases."""
    rng = np.random.default_rng(0)
    gains = np.array([0.9, 1.1, 1.0, 1.0], np.float32)
    colour, after = CameraColour(4, 1e-3), []
    for step in range(20_000):
        camera = step % 4
        noise = rng.normal(0, 0.2, (2, 3)).astype(np.float32)
        colour.step(camera, colour.gain(camera) - gains[camera] + noise[0], noise[1])
        if step in (9_999, 19_999):
            after.append(colour.values.copy())
    np.testing.assert_allclose(after[1].mean(axis=0), IDENTITY, atol=1e-6)
    half, whole = after
    assert np.abs(whole[:, 3:]).max() < 0.02
    assert np.abs(whole - half).max() < 0.01
    # drawn to identity, by a third of a camera's difference at most
    found = (whole[:, :3] - 1) / (gains[:, None] - 1 + 1e-9)
    assert found[:2].min() > 0.67
    assert found[:2].max() < 1.05


def test_corrections_settle_on_a_device_as_here() -> None:
    """Beyond the steps at the whole rate, too."""
    rng = np.random.default_rng(1)
    here, fetched = CameraColour(2, 1e-2), CameraColour(2, 1e-2)
    there = TensorColour(here, Crossing(torch.device("cpu")))
    for step in range(6 * FULL_STEPS):
        gradient = rng.normal(0.1 * (step % 2), 0.2, 6).astype(np.float32)
        here.step(step % 2, gradient[:3], gradient[3:])
        there.update(step % 2, torch.from_numpy(gradient))
    there.fetch(fetched)
    assert np.abs(here.values - IDENTITY).max() > 0.05
    np.testing.assert_allclose(fetched.values, here.values, atol=2e-4)
