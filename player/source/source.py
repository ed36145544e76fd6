"""What a source of slices is: a folder, a server, or a static host.

Every source gives a manifest at once and then slices in birth order, each with the layers it has.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

from codec.errors import InvalidError
from codec.framerange import FrameRange
from codec.slice import Slice
from codec.stream.manifest import Manifest


@dataclass(frozen=True, slots=True)
class ReceivedSlice:
    """A decoded slice as a source hands it out."""

    slice: Slice
    layers: int
    """Layers 0..layers-1 are in it."""
    wire_bytes: int
    """What it took on the wire or on disk, bytes."""

    @property
    def memory_bytes(self) -> int:
        """What it takes decoded, bytes."""
        return self.slice.num_bytes


class Source(Protocol):
    """A stream from one frame on. One thread iterates; `interrupt` may come from another.

    A source gives these properties as plain attributes where they do not change.
    """

    @property
    def name(self) -> str:
        """Where the stream is, as the user named it."""
        ...

    @property
    def manifest(self) -> Manifest: ...

    @property
    def frames(self) -> FrameRange:
        """The frames that will come; their end is None while it is not known."""
        ...

    @property
    def received_bytes(self) -> int:
        """Bytes read so far, everything included."""
        ...

    def slices(self) -> Iterator[ReceivedSlice]:
        """The slices from the first one that shows in `frames.first` to that of the last frame.

        The first `swin_size` are whole; a later one may change only some rows of its lane.
        """
        ...

    def interrupt(self) -> None:
        """Makes whoever waits for a slice raise StoppedError soon."""
        ...

    def close(self) -> None: ...


def check_layers(layers: int | None, manifest: Manifest, name: str) -> int:
    """How many layers to take when `layers` are asked for; None takes all. Raises InvalidError."""
    if layers is None:
        return manifest.num_layers
    if not 1 <= layers <= manifest.num_layers:
        raise InvalidError(
            f"{name} has {manifest.num_layers} layers; --layers {layers} is not within them"
        )
    return layers


def check_frames(frames: FrameRange, manifest: Manifest, num_frames: int, name: str) -> FrameRange:
    """`frames` with the end that they will have. Raises InvalidError when the stream lacks them."""
    beyond = frames.first if frames.end is None else frames.end - 1
    # A live stream may be joined before its first segment stands.
    if frames.first >= (num_frames or int(manifest.live)) or (
        beyond >= num_frames and not manifest.live
    ):
        raise InvalidError(f"{name} has {num_frames} frames; there is no frame {beyond}")
    if frames.end is not None or manifest.live:
        return frames
    return FrameRange(frames.first, num_frames)
