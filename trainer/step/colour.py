"""Per-camera colour: an affine correction of every training camera, learned beside the Gaussians.

Cameras of one rig differ in colour. Each training camera sees gain * picture + bias; the mean
correction over the cameras is held at identity, so that the stream's own colours are the rig's mean
and held-out cameras are scored uncorrected.

A wall that few cameras see could have other colours, and these cameras other corrections: pictures
hardly tell. So corrections are drawn to identity, weakly, and settle as steps are taken; at a
constant rate they wander, and the walls with them.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from codec.arrays import Floats

EPS = 1e-8
"""Of Adam: added to the root of the second moment."""

FULL_STEPS, LEAST_SHARE = 100, 0.01
"""Steps of a camera at the whole learning rate, which falls as their inverse thereafter, and the
share of it that remains, to follow a lamp."""

PULL = 1.0
"""Weight decay: how strongly corrections are drawn to identity, beside a step of Adam."""

IDENTITY = np.array([1, 1, 1, 0, 0, 0], np.float32)


class CameraColour:
    """Gain and bias of every camera, with their own Adam."""

    def __init__(self, num_cameras: int, lr: float) -> None:
        self.lr = lr
        self.values = np.tile(IDENTITY, (num_cameras, 1))  # gain (3), bias (3)
        self._first = np.zeros((num_cameras, 6))
        self._second = np.zeros((num_cameras, 6))
        self._steps = np.zeros(num_cameras)

    def gain(self, camera: int) -> Floats:
        """(3,) float32, of red, green and blue."""
        return self.values[camera, :3]

    def bias(self, camera: int) -> Floats:
        """(3,) float32, of red, green and blue."""
        return self.values[camera, 3:]

    def state(self) -> dict[str, npt.NDArray[Any]]:
        """The values that training changes."""
        return {
            "colour": self.values,
            "colour_first": self._first,
            "colour_second": self._second,
            "colour_steps": self._steps,
        }

    def step(self, camera: int, gain_grad: Floats, bias_grad: Floats) -> None:
        """One update of a camera's correction by gradients of the loss, (3,) each."""
        if self.lr == 0:
            return
        gradient = np.concatenate([gain_grad, bias_grad]).astype(np.float64)
        self._steps[camera] += 1
        count = self._steps[camera]
        # Adam with the betas of `optimiser`.
        self._first[camera] += 0.1 * (gradient - self._first[camera])
        self._second[camera] += 0.001 * (gradient**2 - self._second[camera])
        first = self._first[camera] / (1 - 0.9**count)
        second = self._second[camera] / (1 - 0.999**count)
        step = first / (np.sqrt(second) + EPS) + PULL * (self.values[camera] - IDENTITY)
        rate = self.lr * max(min(1, FULL_STEPS / count), LEAST_SHARE)
        self.values[camera] -= (rate * step).astype(np.float32)
        self.values -= self.values.mean(axis=0) - IDENTITY
