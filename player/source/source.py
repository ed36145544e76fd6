"""Where slices come from: a stream directory, a server, or any static URL.

Every source gives a manifest at once and then slices in birth order, each with the layers it has.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Protocol

from codec.errors import InvalidError
from codec.framerange import FrameRange
from codec.stream import StreamReader
from codec.stream.manifest import Manifest
from player.playout.timeline import ReceivedSlice

from .decode import decode_segment


class Source(Protocol):
    """A stream from one frame on. One thread iterates; `interrupt` may come from another."""

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
        """The slices from the first one that shows in `frames.first` to that of the last frame."""
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


class DirectorySource:
    """A stream directory. One that is still written is played as far as it has come."""

    def __init__(self, path: Path, frames: FrameRange, layers: int | None) -> None:
        """layers: None takes all."""
        self._reader = StreamReader(path)
        self._path = path
        self._layers = check_layers(layers, self.manifest, self.name)
        self._frames = check_frames(frames, self.manifest, self._reader.num_frames, self.name)
        self._received_bytes = self._reader.overhead_bytes

    @property
    def name(self) -> str:
        return str(self._path)

    @property
    def manifest(self) -> Manifest:
        return self._reader.manifest

    @property
    def frames(self) -> FrameRange:
        return self._frames

    @property
    def received_bytes(self) -> int:
        return self._received_bytes

    def slices(self) -> Iterator[ReceivedSlice]:
        reader = self._reader
        birth = self._frames.first - self.manifest.swin_size + 1
        while self._frames.end is None or birth < self._frames.end:
            segment = self.manifest.segment_of(birth)
            if segment >= len(reader.records):
                if self.manifest.live and reader.refresh():
                    continue
                return
            objects = [reader.read_object(segment, layer) for layer in range(self._layers)]
            self._received_bytes += sum(len(data) for data in objects)
            names = [
                str(self._path / self.manifest.object_path(segment, layer))
                for layer in range(self._layers)
            ]
            record = reader.records[segment]
            for received in decode_segment(self.manifest, record, objects, names, birth):
                if self._frames.end is not None and received.slice.birth >= self._frames.end:
                    return
                yield received
                birth = received.slice.birth + 1

    def interrupt(self) -> None:
        """Nothing here waits for longer than a read of the disk."""

    def close(self) -> None:
        pass
