"""A stream's folder as a source; and packets from whole objects, segment by segment, which a folder
and a static host have in common.

Rule: `SegmentReader` does no I/O; the caller asks which parts of which segment are wanted, and
fetches them.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Iterator, Mapping
from pathlib import Path

from codec.errors import CodecError
from codec.framerange import FrameRange
from codec.stream import StreamReader
from codec.stream.integrity import CheckedObject
from codec.stream.manifest import SKIP_MAPS, Manifest, Part, keyframe_part
from codec.stream.reader import DEFAULT_MAX_GAUSSIANS
from player.network.fetch import FetchConfig
from player.network.http import IdleLimit
from player.network.target import StoppedError
from server.abr.clientstatus import ClientStatus

from .sizelimits import SizeLimits
from .source import (
    NO_PLAY,
    REPORT_S,
    Blame,
    KeyframePackets,
    Packets,
    SlicePackets,
    check_frames,
    check_layers,
)

Objects = Mapping[Part, CheckedObject]
"""The objects of one segment."""


class SegmentReader:
    """The packets of `num_layers` layers that `frames` need, in order of birth.

    While `segment` is a number, get its `parts` and iterate over all of their `packets`.
    """

    def __init__(self, manifest: Manifest, num_layers: int, frames: FrameRange) -> None:
        self._manifest = manifest
        self._num_layers = num_layers
        self._end = frames.end
        self._next_segment = manifest.segment_of(frames.first)
        # The slice of a segment's first frame is in its keyframes.
        self._first_birth = self._next_segment * manifest.segment_frames + 1
        self._joined = False

    @property
    def segment(self) -> int | None:
        """The segment that is wanted next; None if none is."""
        first_frame = self._next_segment * self._manifest.segment_frames
        over = self._end is not None and first_frame >= self._end
        return None if over else self._next_segment

    @property
    def parts(self) -> list[Part]:
        """Parts of that segment to get, in the order of their use."""
        layers = range(self._num_layers)
        keyframes = [] if self._joined else list(map(keyframe_part, layers))
        return [*keyframes, SKIP_MAPS, *layers]

    def packets(self, objects: Objects) -> Iterator[Packets]:
        """The packets that the segment adds. objects: its `parts`."""
        layers = range(self._num_layers)
        if not self._joined:
            frame = self._next_segment * self._manifest.segment_frames
            keyframes = tuple(objects[keyframe_part(layer)].packet(frame) for layer in layers)
            yield KeyframePackets(frame, 0, keyframes, _blame(objects, frame))
            self._joined = True
        for birth in objects[0].births:
            if self._end is not None and birth >= self._end:
                break
            if birth >= self._first_birth:
                packets = tuple(objects[layer].packet(birth) for layer in layers)
                skip_map = objects[SKIP_MAPS].packet(birth)
                yield SlicePackets(birth, 0, packets, skip_map, _blame(objects, birth))
        self._next_segment += 1


def _blame(objects: Objects, birth: int) -> Blame:
    """Makes an error name the object of a segment that is at fault."""
    return lambda error, part: objects[part].blamed(error, birth)


log = logging.getLogger(__name__)

POLL_S = 0.2
"""Time between two looks at a stream that is still written, seconds."""

IDLE_S = FetchConfig().idle_s
"""For how long new frames are waited for, seconds."""


class DirectorySource:
    """A stream's folder. One that is still written is followed."""

    def __init__(
        self,
        path: Path,
        frames: FrameRange,
        layers: int | None,
        max_gaussians: int | None = DEFAULT_MAX_GAUSSIANS,
    ) -> None:
        """layers: None takes all. max_gaussians: see `check_gaussians`."""
        self._stopped = threading.Event()
        self._reader = reader = StreamReader(path, max_gaussians)
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

    @property
    def num_frames(self) -> int:
        return self._reader.num_frames

    def packets(self) -> Iterator[Packets]:
        reader = self._reader
        play = SegmentReader(self.manifest, self.num_layers, self.frames)
        limits = SizeLimits(self.manifest)
        while (segment := play.segment) is not None:
            if segment >= len(reader.records):
                if not self._follow():
                    return
                continue
            try:
                limits.check_segment(reader.records[segment])
            except CodecError as error:
                raise error.within(self.name) from error
            objects = {part: reader.read_object(segment, part) for part in play.parts}
            self.received_bytes += sum(len(found.data) for found in objects.values())
            yield from play.packets(objects)

    def _follow(self) -> bool:
        """Waits for the stream to grow; gives whether it has."""
        idle = IdleLimit(IDLE_S, time.monotonic())
        while self.manifest.live:
            if self._reader.refresh():
                return True
            if not idle.left_s(time.monotonic()):
                log.warning("%s: no new frames for %.0f s; the play ends here", self.name, IDLE_S)
                return False
            if self._stopped.wait(POLL_S):
                raise StoppedError(f"{self.name}: stopped")
        return False

    @property
    def report_s(self) -> float:
        return REPORT_S

    def send_status(self, status: ClientStatus) -> bool:
        return False

    def interrupt(self) -> None:
        self._stopped.set()

    def close(self) -> None:
        pass
