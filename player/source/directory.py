"""A stream's folder as a source."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from codec.errors import CodecError
from codec.framerange import FrameRange
from codec.stream import StreamReader
from codec.stream.manifest import Manifest
from server.abr.standing import Standing

from .bounds import Bounds
from .lastplay import NO_PLAY
from .segments import SegmentPlay
from .source import Packets, check_frames, check_layers


class DirectorySource:
    """A stream's folder. One that is still written is played as far as it has come."""

    def __init__(self, path: Path, frames: FrameRange, layers: int | None) -> None:
        """layers: None takes all."""
        self._reader = reader = StreamReader(path)
        self.name = str(path)
        self.play = NO_PLAY
        self.adaptive = False
        self.num_layers = check_layers(layers, reader.manifest, self.name)
        self.frames = check_frames(frames, reader.manifest, reader.num_frames, self.name)
        self.received_bytes = reader.overhead_bytes

    @property
    def manifest(self) -> Manifest:
        """As it is on disk now: a live stream may end while it is played."""
        return self._reader.manifest

    def packets(self) -> Iterator[Packets]:
        reader = self._reader
        play = SegmentPlay(self.manifest, self.num_layers, self.frames)
        bounds = Bounds(self.manifest)
        while (segment := play.segment) is not None:
            if segment >= len(reader.records):
                if self.manifest.live and reader.refresh():
                    continue
                return
            try:
                bounds.check_segment(reader.records[segment])
            except CodecError as error:
                raise error.within(self.name) from error
            objects = {part: reader.read_object(segment, part) for part in play.parts}
            self.received_bytes += sum(len(found.data) for found in objects.values())
            yield from play.packets(objects)

    def tell(self, standing: Standing) -> bool:
        return False

    def interrupt(self) -> None:
        """Nothing here waits for longer than a read of the disk."""

    def close(self) -> None:
        pass
