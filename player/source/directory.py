"""A stream's folder as a source."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Iterator
from pathlib import Path

from codec.errors import CodecError
from codec.framerange import FrameRange
from codec.stream import StreamReader
from codec.stream.manifest import Manifest
from codec.stream.reader import DEFAULT_MAX_GAUSSIANS
from player.network.faults import StoppedError
from player.network.fetch import FetchConfig
from player.network.idle import IdleLimit
from server.abr.clientstatus import ClientStatus

from .segmentreader import SegmentReader
from .sizelimits import SizeLimits
from .source import NO_PLAY, REPORT_S, Packets, check_frames, check_layers

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
