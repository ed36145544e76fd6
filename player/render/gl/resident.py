"""The interface of both ways of drawing: Gaussians that stay on the GPU, ordered and drawn."""

from __future__ import annotations

from typing import Any, Protocol

from codec.camera import Camera

from ..patch import PackedLanes
from .rowpacker import RowPacker


class Resident(Protocol):
    """The Gaussians of the window on the GPU. The context is current in every call."""

    @property
    def packer(self) -> RowPacker | PackedLanes:
        """Packs slices for `upload`; belongs to the thread that puts, and makes no GL call."""
        ...

    def upload(self, packed: Any) -> int:
        """Writes what the slice that `packer` packed changes; gives how many bytes."""
        ...

    def start_glide(self, frame: int) -> None:
        """Called when all slices up to `frame` are uploaded: the changes of the slice born at
        `frame` may be drawn on their way. Puts all other Gaussians at their final places."""
        ...

    def glide(self, share: float) -> int | None:
        """See Renderer.glide; gives how many bytes were written, None if nothing changed."""
        ...

    def sort(self, frame: int, camera: Camera) -> None:
        """Finds which Gaussians show in `frame`, farthest first."""
        ...

    def draw(self, camera: Camera, depths: bool = False) -> None:
        """Blends what was sorted last into the target, which is in use, as are the blend modes:
        colours, or depths in metres."""
        ...
