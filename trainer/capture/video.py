"""Frames of a video by number, through PyAV.

Reading forward decodes each frame once. Any other frame is reached from the key frame before it,
found by the time stamps of the file's packets, so that a frame number means the same picture
however one comes to it.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

import av
import av.container
import av.error
import av.video.stream
import numpy as np

from codec.camera import Camera
from trainer.errors import CaptureError
from trainer.storedfiles import block_file, by_its_name, translated

from .capture import Picture, check_frame

MAX_SKIP_FRAMES = 12
"""Frames decoded and dropped rather than looking for a nearer key frame: that costs about as much
as a seek."""

VIDEO_SUFFIXES = frozenset({".mp4", ".mov", ".mkv", ".webm", ".avi"})

VIDEOS_NAME = "videos"
"""Folder of a capture's videos, in layouts that name it."""

VARIABLE_SHARE = 0.1
"""Deviation from the usual time between two frames, as a share: containers round by less."""

HDR_CURVES = {16: "PQ", 18: "HLG"}
"""Transfer curves of HDR, by their numbers in ITU-T H.273."""

TO_SDR = (
    "zscale=t=linear:npl=100,format=gbrpf32le,zscale=p=bt709,tonemap=hable,"
    "zscale=t=bt709:m=bt709:r=tv,format=yuv420p"
)
"""Filters of ffmpeg that make SDR of HDR."""


@dataclass(frozen=True, slots=True)
class VideoFacts:
    """Properties of a video by its container, without decoding it."""

    width_px: int
    height_px: int
    num_frames: int
    fps: float
    turned_deg: int = 0
    """Angle by which the pictures are turned when they are read, 0, 90, 180 or 270,
    counterclockwise: phones note it in the file. The size is that of the turned pictures."""
    times_s: tuple[float, ...] | None = None
    """The time of each frame after the first one; None where the rate is constant."""


@dataclass(frozen=True, slots=True)
class _TimeTable:
    """The presentation times of a video, in units of its time base."""

    frames: tuple[int, ...]
    """The time of each frame, ascending."""
    keys: tuple[int, ...]
    """The time of each key frame, ascending."""


def probe_video(path: Path) -> VideoFacts:
    """The facts of a video file. Raises CaptureError for a file that is not a video.

    The frame count comes from the sample table of an MP4 file, unless the file's duration
    contradicts it (an edit list hides frames) or its frames are not evenly spaced; then, and for
    other containers, the packets are read.
    """
    try:
        with translated(), _open_container(path) as container:
            stream = _video_stream(path, container)
            if container.format.name.endswith("_pipe"):
                raise CaptureError(f"{path}: a still picture, not a video")
            rate = stream.average_rate or stream.guessed_rate
            if not rate:
                raise CaptureError(f"{path}: the video does not declare its frame rate")
            _check_transfer(path, stream.codec_context.color_trc)
            fps = float(rate)
            num_frames = stream.frames if "mp4" in container.format.name else 0
            shown = float(container.duration or 0) / 1e6 * fps
            times_s = None
            if abs(shown - num_frames) > 1.5 or not _has_constant_rate(stream, num_frames):
                ticks = _read_times(path, container, stream).frames
                num_frames = len(ticks)
                tick_s = float(stream.time_base or 0)
                if not _is_even(ticks):
                    times_s = tuple((t - ticks[0]) * tick_s for t in ticks)
            size = stream.codec_context.width, stream.codec_context.height
        with translated(), _open_container(path) as container:
            turned_deg = _turned(path, container, _video_stream(path, container))
    except av.error.FFmpegError as error:
        raise CaptureError(f"{path}: not a video that can be read: {error.strerror}") from error
    if num_frames == 0:
        raise CaptureError(f"{path}: the video has no frames")
    if turned_deg in (90, 270):
        size = size[::-1]
    return VideoFacts(*size, num_frames, fps, turned_deg, times_s)


def _has_constant_rate(stream: av.video.stream.VideoStream, num_frames: int) -> bool:
    """Whether the file's table has that many frames, all equally far apart."""
    ticks = [entry.timestamp for entry in stream.index_entries]
    if not len(ticks) == num_frames > 0 or not _is_even(ticks):
        return False
    # These are times of decoding. Where frames are stored in another order, they lag behind those
    # of showing, and the last gaps are only seen in the duration.
    gap = (ticks[-1] - ticks[0]) / max(1, num_frames - 1)
    return num_frames == 1 or abs((stream.duration or 0) - num_frames * gap) <= gap / 2


def _is_even(ticks: Sequence[int]) -> bool:
    """Whether the times between frames differ by no more than their rounding."""
    gaps = np.diff(ticks)
    return len(gaps) < 2 or float(np.ptp(gaps)) <= max(1.0, VARIABLE_SHARE * float(np.median(gaps)))


def _check_transfer(path: Path, transfer: int) -> None:
    """Raises CaptureError for a transfer curve of HDR: read as an ordinary one, its colours are
    pale, and unlike those of other cameras."""
    if transfer in HDR_CURVES:
        raise CaptureError(
            f"{path}: is HDR ({HDR_CURVES[transfer]}), and only SDR is read: convert all cameras "
            f"alike, e.g. with ffmpeg -i {path.name} -vf {TO_SDR} -c:v libx264 -crf 12 OUT.mp4"
        )


def _turned(
    path: Path, container: av.container.InputContainer, stream: av.video.stream.VideoStream
) -> int:
    """`VideoFacts.turned_deg`, which the first picture holds; 0 if that cannot be decoded."""
    stream.codec_context.thread_count = 1
    with suppress(av.error.FFmpegError):
        for picture in container.decode(stream):
            turned_deg = int(picture.rotation) % 360
            if turned_deg % 90:
                raise CaptureError(
                    f"{path}: the file turns its pictures by {turned_deg} degrees; only quarter "
                    "turns are read: write it upright first, with ffmpeg -i IN.mp4 OUT.mp4"
                )
            return turned_deg
    return 0


def check_video_size(path: Path, facts: VideoFacts, camera: Camera, declared_in: Path) -> None:
    """Raises CaptureError unless the video has the size of its camera, which `declared_in`
    declares."""
    if (facts.width_px, facts.height_px) == (camera.width_px, camera.height_px):
        return
    turned = f", turned by {facts.turned_deg} degrees as the file says" if facts.turned_deg else ""
    raise CaptureError(
        f"{path}: is {facts.width_px}x{facts.height_px} px{turned}; {declared_in.name} declares "
        f"{camera.width_px}x{camera.height_px} px"
    )


class VideoSource:
    """Pictures of one camera, a video. Keeps its decoder open between reads.

    One thread at a time. The decoder runs in that thread: with dozens of cameras open,
    frame-parallel decoders would hold a dozen pictures each.
    """

    def __init__(self, path: Path, camera: Camera, num_frames: int) -> None:
        self._path = path
        self._camera = camera
        self._num_frames = num_frames
        self._container: av.container.InputContainer | None = None
        self._decoded: Iterator[av.VideoFrame] = iter(())
        self._next = 0  # the number of the frame that _decoded yields next
        self._table: _TimeTable | None = None
        self.decoded_frames = 0
        """Frames decoded so far, also those passed over on the way to another."""

    def read(self, frame: int) -> Picture:
        check_frame(frame, self._num_frames, self._camera.name)
        with by_its_name(self._path), translated():
            return self._read(frame)

    def _read(self, frame: int) -> Picture:
        try:
            self._approach(frame)
            while True:
                picture = next(self._decoded, None)
                if picture is None:
                    raise self._too_short(frame)
                self.decoded_frames += 1
                self._next += 1
                if self._next > frame:
                    return self._as_rgb(picture)
        except av.error.FFmpegError as error:
            self.close()
            raise CaptureError(
                f"{self._path}: frame {frame} cannot be decoded: {error.strerror}"
            ) from error

    def close(self) -> None:
        if self._container is not None:
            self._container.close()
            self._container = None
            self._decoded = iter(())

    def _approach(self, frame: int) -> None:
        """Brings _decoded to the frame, or before it with no key frame in between."""
        opened = self._container is not None
        if opened and self._next <= frame <= self._next + MAX_SKIP_FRAMES:
            return
        container, stream = self._open()
        if not opened and frame <= MAX_SKIP_FRAMES:
            return
        if self._table is None:
            with _open_container(self._path) as counted:
                self._table = _read_times(self._path, counted, _video_stream(self._path, counted))
        times, keys = self._table.frames, self._table.keys
        if frame >= len(times):
            raise self._too_short(frame)
        key = bisect_right(keys, times[frame]) - 1
        if opened and self._next <= frame and (key < 0 or keys[key] <= times[self._next]):
            return
        # A seek may land behind the frame (open groups of pictures drop their first frames): go
        # back key by key.
        for target in keys[max(key, 0) :: -1]:
            container.seek(target, stream=stream, backward=True)
            self._decoded = container.decode(stream)
            landed = next(self._decoded, None)
            if landed is None or landed.pts is None:
                continue
            if landed.pts <= times[frame]:
                self._next = bisect_right(times, landed.pts) - 1
                self._decoded = chain([landed], self._decoded)
                return
            self.decoded_frames += 1
        self.close()
        self._open()

    def _open(self) -> tuple[av.container.InputContainer, av.video.stream.VideoStream]:
        if self._container is None:
            container = _open_container(self._path)
            stream = _video_stream(self._path, container)
            stream.codec_context.thread_count = 1
            self._container = container
            self._decoded = container.decode(stream)
            self._next = 0
        return self._container, _video_stream(self._path, self._container)

    def _too_short(self, frame: int) -> CaptureError:
        return CaptureError(
            f"{self._path}: ends before frame {frame} of the {self._num_frames} that it declares"
        )

    def _as_rgb(self, picture: av.VideoFrame) -> Picture:
        quarters = int(picture.rotation) % 360 // 90
        size_px = (picture.width, picture.height)[:: -1 if quarters % 2 else 1]
        if size_px != (self._camera.width_px, self._camera.height_px):
            raise CaptureError(
                f"{self._path}: a frame is {size_px[0]}x{size_px[1]} px, not "
                f"{self._camera.width_px}x{self._camera.height_px} px"
            )
        upright = np.rot90(picture.to_ndarray(format="rgb24"), quarters)
        return np.ascontiguousarray(upright, np.uint8)


def _open_container(path: Path) -> av.container.InputContainer:
    if path.exists() and not path.is_file():
        raise CaptureError(f"{path}: not a video but a folder, a pipe or a device")
    stored = block_file(path)
    # Only local files: a playlist under a video's name must not reach for the network. The prefix
    # keeps a colon in a path from being read as a protocol.
    source = f"file:{path}" if stored is None else stored
    return av.open(source, "r", options={"protocol_whitelist": "file"})


def _video_stream(
    path: Path, container: av.container.InputContainer
) -> av.video.stream.VideoStream:
    if not container.streams.video:
        raise CaptureError(f"{path}: holds no video")
    return container.streams.video[0]


def _read_times(
    path: Path, container: av.container.InputContainer, stream: av.video.stream.VideoStream
) -> _TimeTable:
    """Reads every packet and decodes none."""
    frames: list[int] = []
    keys: list[int] = []
    for packet in container.demux(stream):
        if packet.size == 0 or packet.is_discard:
            continue
        if packet.pts is None:
            raise CaptureError(f"{path}: a packet has no time stamp; remux the video into MP4")
        frames.append(packet.pts)
        if packet.is_keyframe:
            keys.append(packet.pts)
    return _TimeTable(tuple(sorted(frames)), tuple(sorted(keys)))
