"""The interface of both ways of drawing: Gaussians that stay on the GPU, ordered and drawn."""

from __future__ import annotations

from typing import Protocol, TypeVar

from codec.camera import Camera
from codec.slice import Slice

Packed = TypeVar("Packed", bound="OfLane")


class OfLane(Protocol):
    """A slice as a Resident takes it."""

    @property
    def lane(self) -> int: ...


PackedOut = TypeVar("PackedOut", bound=OfLane, covariant=True)


class Packer(Protocol[PackedOut]):
    """Packs slices; belongs to the thread that puts, and makes no GL call."""

    def pack(self, slice: Slice) -> PackedOut:
        """The slice, which fits a lane. Raises InvalidError if it changes what its lane lacks."""
        ...

    def forget(self, lane: int) -> None:
        """Packed slices of `lane` may never be uploaded: only a whole slice can follow."""
        ...


class Resident(Protocol[Packed]):
    """The Gaussians of the window on the GPU. The context is current in every call."""

    @property
    def packer(self) -> Packer[Packed]: ...

    def upload(self, packed: Packed) -> int:
        """Writes what the slice changes; gives how many bytes."""
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
