"""Training pictures as the loss wants them: planar floats, whole or at half the size."""

from __future__ import annotations

import numpy as np

from codec.arrays import Floats
from trainer.pictures.shot import Shot

from .loss import Workspace


class Targets:
    """Converts pictures; keeps one target and one workspace of the loss for every size."""

    def __init__(self) -> None:
        self._held: dict[tuple[int, int], tuple[Floats, Workspace]] = {}

    def take(self, shot: Shot) -> tuple[Floats, Workspace]:
        """The shot's picture as (3, h, w) float32 in 0..1, and the workspace for it. The next call
        of that size reuses both."""
        if shot.shape not in self._held:
            shape = (3, *shot.shape)
            self._held[shot.shape] = np.empty(shape, np.float32), Workspace(shape)
        target, workspace = self._held[shot.shape]
        shot.fill(target)
        return target, workspace
