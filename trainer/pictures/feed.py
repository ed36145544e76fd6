"""What training sees of a capture."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
import numpy.typing as npt

from codec.camera import Camera


class Pictures(Protocol):
    """What training sees: frames 0..num_frames-1 of the training cameras."""

    @property
    def num_frames(self) -> int: ...

    @property
    def cameras(self) -> Sequence[Camera]: ...

    def picture(self, camera: int, frame: int) -> npt.NDArray[np.uint8]:
        """(H, W, 3) uint8, of the camera's size."""
        ...

    def mask(self, camera: int, frame: int) -> npt.NDArray[np.uint8] | None:
        """(H, W): 1 where a pixel of the picture counts, 0 where not; None if all do."""
        ...
