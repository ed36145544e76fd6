"""Frames like those of a deformation network: every Gaussian sways and jitters, some end, others
begin, and each frame has its own order."""

from __future__ import annotations

import numpy as np

from codec.arrays import Floats
from codec.splats import Splats
from tests.support.trained_like import trained_like_splats

FPS = 30.0
SWAY_M = 0.13
"""Amplitude of the motion, which is nearly the same for neighbours."""
SWAY_HZ = 0.38
JITTER = 3e-4, 0.004, 0.002, 0.02
"""Standard deviations of the noise added in each frame to means (metres), log-scales, quaternions
and logits of opacities."""
BORN_SHARE = 0.008
"""Share of the Gaussians that end in a frame and are replaced."""
POOL = 4
"""Number of all Gaussians, as a multiple of those of a frame."""
ABSENT_SHARE = 0.004
"""Maximum share of the Gaussians that are missing in a frame."""


class Deforming:
    """Generates frame after frame. A model of SH degree 3 has strong view dependence."""

    def __init__(self, count: int, sh_degree: int = 3, seed: int = 0) -> None:
        self._rng = np.random.default_rng(seed)
        self._count = count
        # One surface with one colouring, so that new Gaussians match the existing ones.
        self._pool = trained_like_splats(POOL * count, seed, sh_degree)
        self._model = self._pool.take(slice(count))
        self._num_born = count
        self._frame = 0

    def next(self) -> Splats:
        """The Gaussians of the next frame: at most `count`, in any order."""
        rng, count = self._rng, self._count
        if self._frame:
            self._renew()
        means, log_scales, quats, logits, sh = self._model.arrays
        swayed = means + self._sway(means)
        means, log_scales, quats, logits = (
            (array + rng.normal(0, sigma, array.shape)).astype(np.float32)
            for array, sigma in zip((swayed, log_scales, quats, logits), JITTER, strict=True)
        )
        here = rng.permutation(count)[: count - int(rng.integers(0, int(1 + ABSENT_SHARE * count)))]
        self._frame += 1
        return Splats(means, log_scales, quats, logits, sh).take(here)

    def _renew(self) -> None:
        """Replaces some Gaussians by others."""
        ended = np.flatnonzero(self._rng.random(self._count) < BORN_SHARE)
        born = (self._num_born + np.arange(len(ended))) % len(self._pool)
        self._num_born += len(ended)
        arrays = [array.copy() for array in self._model.arrays]
        for array, other in zip(arrays, self._pool.arrays, strict=True):
            array[ended] = other[born]
        self._model = Splats(*arrays)

    def _sway(self, means: Floats) -> Floats:
        """(N, 3) displacements in metres, smooth in space and time."""
        phase = 2 * np.pi * SWAY_HZ * self._frame / FPS
        x, y, z = means.T.astype(np.float64)
        turn = np.stack([np.sin(phase + 2 * y), np.sin(1.3 * phase + x), np.cos(phase + z)], axis=1)
        return (SWAY_M * turn).astype(np.float32)
