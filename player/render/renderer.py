"""The interface of every renderer.

`put` and `forget_waiting` may be called from other threads; everything else belongs to the thread
that made the renderer.
"""

from __future__ import annotations

from enum import StrEnum
from typing import Protocol

from codec.arrays import Floats
from codec.camera import Camera
from codec.errors import UnsupportedError
from codec.slice import Slice
from codec.stream.manifest import Manifest

from .cpu import StepTimes


class RendererKind(StrEnum):
    AUTO = "auto"
    """OpenGL where it works, else the CPU."""
    GL = "gl"
    CPU = "cpu"


class GlVersion(StrEnum):
    AUTO = "auto"
    """4.3 where there is one on a GPU, else 3.3."""
    V33 = "3.3"
    """The version that macOS, Mesa's software renderer and old integrated GPUs all have."""
    V43 = "4.3"
    """With compute shaders, which order the Gaussians on the GPU."""

    @property
    def code(self) -> int:
        """As OpenGL's tools write it; of AUTO the least."""
        return 430 if self is GlVersion.V43 else 330


class Renderer(Protocol):
    """Draws frames of a stream whose slices are put into it in birth order."""

    @property
    def name(self) -> str:
        """Name of the renderer, for people."""
        ...

    @property
    def uploaded_bytes(self) -> int:
        """Bytes of slices copied to where they are drawn from, so far."""
        ...

    times: StepTimes | None
    """Set it to have the steps timed, each until it is finished, which costs some overlap."""

    alpha: bool
    """Whether pictures have a fourth channel, 0..1: how much of a pixel the Gaussians cover. The
    colours are premultiplied by it. False until it is set."""

    def put(self, slice: Slice) -> None:
        """Takes the slice over; it shows from the first `upload` of a frame >= its birth on.

        Raises InvalidError here or in that `upload` if it does not fit its lane, or has rows and
        does not follow the slice that its lane got last.
        """
        ...

    def forget_waiting(self) -> None:
        """Drops the slices that were put but not uploaded, as for a seek; the next slice of each of
        their lanes has to be a whole one."""
        ...

    def upload(self, frame: int) -> None:
        """Brings the slices born up to `frame` to where they are drawn from.

        What they replace is gone: only frames from their births on can be drawn after it.
        """
        ...

    def glide(self, share: float) -> bool:
        """Draws what the slice of the frame that was uploaded last changes at `share` of its way,
        0 to 1, from the frame before, until the next upload: see codec/slice.py. Gives whether
        that is another picture. Only slices with a motion change anything."""
        ...

    def render(self, frame: int, camera: Camera) -> Floats:
        """Uploads up to `frame`, then draws it; see render_again."""
        ...

    def render_again(self, frame: int, camera: Camera) -> Floats:
        """(H, W, 3) float32 picture of `frame` from what is uploaded, whatever waits: row 0 on top,
        black background, not clamped; (H, W, 4) if `alpha` is set."""
        ...

    def close(self) -> None: ...


def check_drawable(manifest: Manifest) -> None:
    """Raises UnsupportedError for a stream that recipe v1 would draw wrongly."""
    if manifest.antialias:
        raise UnsupportedError(
            "the stream was trained with opacity compensation (antialias); recipe v1 lacks it"
        )
