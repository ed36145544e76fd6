"""A stream directory as a source."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from codec.framerange import FrameRange
from codec.stream import StreamReader
from codec.stream.manifest import Manifest

from .source import ReceivedSlice, check_frames, check_layers, segment_slices


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
            self._received_bytes += sum(len(layer.data) for layer in objects)
            for received in segment_slices(objects, birth):
                if self._frames.end is not None and received.slice.birth >= self._frames.end:
                    return
                yield received
                birth = received.slice.birth + 1

    def interrupt(self) -> None:
        """Nothing here waits for longer than a read of the disk."""

    def close(self) -> None:
        pass
