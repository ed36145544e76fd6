"""What the two ways of drawing share: Gaussians that stay on the GPU, ordered and drawn."""

from __future__ import annotations

from typing import Protocol

from codec.camera import Camera

from ..patch import PackedLanes, PackedSlice


class Resident(Protocol):
    """The Gaussians of the window on the GPU. The context is current in every call."""

    lanes: PackedLanes
    """Packs slices as `put` takes them; belongs to the thread that packs."""

    def put(self, packed: PackedSlice) -> int:
        """Writes what the slice changes; gives how many bytes."""
        ...

    def sort(self, frame: int, camera: Camera) -> None:
        """Finds which Gaussians show in `frame`, farthest first."""
        ...

    def draw(self, camera: Camera) -> None:
        """Blends what was sorted last into the target, which is in use, as are the blend modes."""
        ...
