"""The pictures that training asks for, at its scale: read when first needed, kept within a bound.

State: the kept pictures in order of use, and one source per camera. When full, the least recently
used picture goes; to ask for it again reads it again.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from dataclasses import dataclass
from types import TracebackType

import numpy as np
from PIL import Image

from codec.camera import Camera
from codec.errors import InvalidError

from .capture.capture import Capture, Picture

DEFAULT_MAX_BYTES = 1 << 30
"""Bytes of pictures kept: 30 cameras x 200 frames at 320x180, or 30 x 8 at 1352x1014."""


@dataclass(frozen=True, slots=True)
class CacheStatistics:
    """What a cache did so far."""

    hits: int
    """Pictures answered from memory."""
    misses: int
    """Pictures read from the capture."""
    evictions: int
    """Pictures dropped for room."""
    held_bytes: int
    """Bytes of the pictures held now."""


class FrameCache:
    """Pictures of a range of frames of a capture, scaled, held in at most `max_bytes`.

    Any thread may ask. Reads of one camera wait for each other, so a prefetching thread and the
    trainer share one decoder; pictures are handed out read-only because they are shared.
    """

    def __init__(
        self,
        capture: Capture,
        frames: range,
        scale: float = 1.0,
        max_bytes: int = DEFAULT_MAX_BYTES,
    ) -> None:
        """Opens nothing yet.

        frames: the frames that may be asked for, by their number in the capture, step 1. scale:
        size of the pictures handed out over the size of the capture's, in (0, 1]. Raises
        InvalidError for frames outside the capture, a scale outside (0, 1], or a bound that cannot
        hold one picture.
        """
        if not 0 < scale <= 1:
            raise InvalidError(f"scale {scale}: must be above 0 and at most 1")
        if not frames or frames.step != 1 or frames[0] < 0 or frames[-1] >= capture.num_frames:
            raise InvalidError(
                f"frames {frames.start}:{frames.stop}: "
                f"{capture.root} has frames 0:{capture.num_frames}"
            )
        self.capture = capture
        self.frames = frames
        self._cameras = tuple(scaled_camera(c.camera, scale) for c in capture.cameras)
        largest_bytes = max(3 * c.width_px * c.height_px for c in self._cameras)
        if max_bytes < largest_bytes:
            raise InvalidError(f"max_bytes {max_bytes}: one picture takes {largest_bytes} bytes")
        self._max_bytes = max_bytes
        self._sources = tuple(capture.open_images(i) for i in range(len(capture.cameras)))
        self._source_locks = tuple(threading.Lock() for _ in capture.cameras)
        self._lock = threading.Lock()  # guards all below
        self._held: OrderedDict[tuple[int, int], Picture] = OrderedDict()
        self._held_bytes = 0
        self._hits = self._misses = self._evictions = 0

    def camera(self, camera_index: int) -> Camera:
        """The camera at the size of the pictures handed out."""
        return self._cameras[camera_index]

    def image(self, camera_index: int, frame: int) -> Picture:
        """(h, w, 3) uint8 RGB, read-only. Raises CaptureError when the capture cannot be read."""
        if frame not in self.frames:
            raise InvalidError(f"frame {frame}: outside {self.frames.start}:{self.frames.stop}")
        key = camera_index, frame
        picture = self._look_up(key)
        if picture is not None:
            return picture
        with self._source_locks[camera_index]:
            picture = self._look_up(key)  # another thread may have read it meanwhile
            if picture is not None:
                return picture
            picture = scaled_picture(
                self._sources[camera_index].read(frame), self._cameras[camera_index]
            )
            picture.setflags(write=False)
            self._keep(key, picture)
        return picture

    @property
    def statistics(self) -> CacheStatistics:
        with self._lock:
            return CacheStatistics(self._hits, self._misses, self._evictions, self._held_bytes)

    def close(self) -> None:
        """Frees the decoders and the pictures. Idempotent; a later request reads anew."""
        for lock, source in zip(self._source_locks, self._sources, strict=True):
            with lock:
                source.close()
        with self._lock:
            self._held.clear()
            self._held_bytes = 0

    def __enter__(self) -> FrameCache:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _look_up(self, key: tuple[int, int]) -> Picture | None:
        with self._lock:
            picture = self._held.get(key)
            if picture is not None:
                self._held.move_to_end(key)
                self._hits += 1
            return picture

    def _keep(self, key: tuple[int, int], picture: Picture) -> None:
        with self._lock:
            self._misses += 1
            while self._held and self._held_bytes + picture.nbytes > self._max_bytes:
                _, dropped = self._held.popitem(last=False)
                self._held_bytes -= dropped.nbytes
                self._evictions += 1
            self._held[key] = picture
            self._held_bytes += picture.nbytes


def scaled_camera(camera: Camera, scale: float) -> Camera:
    """The camera of pictures scaled by `scale`, their sides rounded to whole pixels."""
    return camera.resized(
        max(1, round(camera.width_px * scale)), max(1, round(camera.height_px * scale))
    )


def scaled_picture(picture: Picture, camera: Camera) -> Picture:
    """The picture on the pixel grid of a scaled camera; every new pixel is the mean of the area it
    covers.

    With sides that divide evenly (scale 0.5: 2x2) the mean is over whole pixels, rounded once.
    """
    height_px, width_px = picture.shape[:2]
    if (width_px, height_px) == (camera.width_px, camera.height_px):
        return picture
    image = Image.fromarray(picture)
    if width_px % camera.width_px == 0 and height_px % camera.height_px == 0:
        return np.array(image.reduce((width_px // camera.width_px, height_px // camera.height_px)))
    return np.array(image.resize((camera.width_px, camera.height_px), Image.Resampling.BOX))


def parse_frames(text: str, num_frames: int) -> range:
    """The range of "A:B" (A included, B not; either may be left out). Raises InvalidError."""
    first, colon, last = text.partition(":")
    try:
        frames = range(int(first or 0), int(last or num_frames))
    except ValueError as error:
        raise InvalidError(f"frames {text!r}: write A:B, two frame numbers") from error
    if not colon or not 0 <= frames.start < frames.stop <= num_frames:
        raise InvalidError(f"frames {text!r}: write A:B with 0 <= A < B <= {num_frames}")
    return frames
