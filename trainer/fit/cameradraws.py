"""Which camera an iteration looks through: in turn, and more often where more is wrong."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt


class CameraDraws:
    """Draws cameras by their errors, so that none falls behind its share for long.

    Every draw adds its share to what each camera is owed; one of those that are owed most is drawn
    and pays 1. So it is a shuffle of all cameras while they are equally wrong.
    """

    def __init__(self, num_cameras: int) -> None:
        self._owed = np.zeros(num_cameras)
        self._losses = np.zeros(num_cameras)

    def state(self) -> dict[str, npt.NDArray[Any]]:
        """The values that training changes. Views, not copies."""
        return {"cameras_owed": self._owed, "cameras_losses": self._losses}

    def shares(self, error_share: float) -> npt.NDArray[np.float64]:
        """(C,) how often each camera is drawn, as a share of all draws. error_share: of them, those
        that go by errors; the rest is for all alike."""
        count = len(self._losses)
        even = np.full(count, 1 / count)
        seen = self._losses > 0
        if not seen.any():
            return even
        # A camera that was not drawn yet counts with the mean error of the others.
        losses = np.where(seen, self._losses, self._losses[seen].mean())
        shares: npt.NDArray[np.float64] = losses / losses.sum()
        return (1 - error_share) * even + error_share * shares

    def draw(self, rng: np.random.Generator, error_share: float) -> int:
        """The camera of the next iteration; error_share as in `shares`."""
        self._owed += self.shares(error_share)
        most = np.flatnonzero(self._owed > self._owed.max() - 0.5)
        camera = int(rng.choice(most))
        self._owed[camera] -= 1
        return camera

    def note(self, camera: int, loss: float) -> None:
        """Takes in the loss of an iteration that looked through `camera`."""
        self._losses[camera] = loss
