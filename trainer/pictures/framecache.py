"""The pictures and masks that training asks for, at its scale: read when first needed or ahead of
it, kept within a bound.

State: the kept pictures and masks in order of use, one source per camera, and the thread that reads
ahead, for which a bounded number of jobs may wait. When full, the least recently used goes; to ask
for it again reads it again.
"""

from __future__ import annotations

import threading
from collections import OrderedDict, deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Generic, NamedTuple, Protocol, TypeVar

from codec.arrays import Bytes
from codec.camera import Camera
from codec.errors import InvalidError
from trainer.capture.capture import Capture, Mask, Picture

from .scale import Shot, scaled_mask, scaled_picture

_Job = TypeVar("_Job")


class Prefetcher(Generic[_Job]):
    """Does jobs in the order in which they were asked for; refuses one when too many wait.

    Any thread may ask. The thread starts with the first job and ends with `close`.
    """

    def __init__(self, do: Callable[[_Job], None], max_waiting: int) -> None:
        """do: what to do with a job; must not raise."""
        self._do = do
        self._max_waiting = max_waiting
        self._changed = threading.Condition()  # guards all below
        self._waiting: deque[_Job] = deque()
        self._thread: threading.Thread | None = None

    def ask(self, job: _Job) -> bool:
        """Queues a job; False if too many wait."""
        with self._changed:
            if len(self._waiting) >= self._max_waiting:
                return False
            self._waiting.append(job)
            if self._thread is None:
                self._thread = threading.Thread(target=self._work, name="prefetch", daemon=True)
                self._thread.start()
            self._changed.notify()
            return True

    def close(self) -> None:
        """Forgets the jobs that wait and returns when the running one has ended. Idempotent; a
        later job starts a new thread."""
        with self._changed:
            self._waiting.clear()
            thread, self._thread = self._thread, None
            self._changed.notify_all()
        if thread is not None:
            thread.join()

    def _work(self) -> None:
        while True:
            with self._changed:
                while not self._waiting and self._thread is threading.current_thread():
                    self._changed.wait()
                if self._thread is not threading.current_thread():
                    return
                job = self._waiting.popleft()
            self._do(job)


DEFAULT_MAX_BYTES = 1 << 30
"""Bytes of pictures kept: 30 cameras x 200 frames at 320x180, or 30 x 8 at 1352x1014."""

DEFAULT_MAX_REQUESTS = 256
"""Pictures that may wait to be read ahead: two frames of more than a hundred cameras."""


@dataclass(frozen=True, slots=True)
class CacheStatistics:
    """Counters of a cache so far, and its size."""

    hits: int
    """Pictures and masks answered from memory."""
    misses: int
    """Pictures and masks read because they were asked for."""
    evictions: int
    """Pictures and masks dropped for room."""
    held_bytes: int
    """Bytes of the pictures and masks held now."""
    prefetched: int
    """Pictures and masks read ahead."""
    prefetch_dropped: int
    """Requests to read ahead that found too many waiting."""
    prefetch_skipped: int
    """Pictures and masks not read ahead because one still needed would have had to go."""
    prefetch_failed: int
    """Pictures and masks that could not be read ahead; a request for one raises the error."""


class _Key(NamedTuple):
    camera: int
    frame: int
    is_mask: bool = False


class _Request(NamedTuple):
    camera: int
    frame: int
    needed_from: int


class FrameCache:
    """Pictures of a range of frames of a capture, scaled, held in at most `max_bytes`.

    Any thread may ask. Reads of one camera wait for each other, so the thread that reads ahead and
    the trainer share one decoder; pictures are handed out read-only because they are shared.
    """

    def __init__(
        self,
        capture: Capture,
        frames: range,
        scale: float = 1.0,
        max_bytes: int = DEFAULT_MAX_BYTES,
        max_requests: int = DEFAULT_MAX_REQUESTS,
        cameras: Sequence[Camera] | None = None,
    ) -> None:
        """Opens nothing yet.

        frames: the frames that may be asked for, by their number in the capture, step 1. scale:
        size of the pictures handed out over the size of the capture's, in (0, 1]. cameras: instead
        of a scale, all of the capture's cameras at the sizes wanted. max_requests: pictures that
        may wait to be read ahead. Raises InvalidError for frames outside the capture, a scale
        outside (0, 1], or a bound that cannot hold one picture.
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
        if cameras is None:
            cameras = [c.camera.scaled(scale) for c in capture.cameras]
        self._cameras = tuple(cameras)
        largest_bytes = max(3 * c.width_px * c.height_px for c in self._cameras)
        if max_bytes < largest_bytes:
            raise InvalidError(f"max_bytes {max_bytes}: one picture takes {largest_bytes} bytes")
        self._max_bytes = max_bytes
        self._sources = tuple(capture.open_images(i) for i in range(len(capture.cameras)))
        self._source_locks = tuple(threading.Lock() for _ in capture.cameras)
        self._prefetcher = Prefetcher(self._read_ahead, max_requests)
        self._lock = threading.Lock()  # guards all below
        self._held: OrderedDict[_Key, Bytes] = OrderedDict()
        self._held_bytes = 0
        self._hits = self._misses = self._evictions = 0
        self._prefetched = self._dropped = self._skipped = self._failed = 0

    def camera(self, camera_index: int) -> Camera:
        """The camera at the size of the pictures handed out."""
        return self._cameras[camera_index]

    def shot(self, camera_index: int, frame: int) -> Shot:
        """The picture and its mask, read-only. Raises CaptureError when the capture cannot be
        read."""
        return Shot(self.image(camera_index, frame), self.mask(camera_index, frame))

    def image(self, camera_index: int, frame: int) -> Picture:
        """(h, w, 3) uint8 RGB, read-only. Raises CaptureError when the capture cannot be read."""
        self._check_frame(frame)
        return self._get(_Key(camera_index, frame))

    def mask(self, camera_index: int, frame: int) -> Mask | None:
        """(h, w) uint8, read-only: 1 where a pixel of `image` counts, 0 where it does not; None if
        all do. Raises CaptureError when the capture cannot be read."""
        self._check_frame(frame)
        key = self._mask_key(camera_index, frame)
        return None if key is None else self._get(key)

    def prefetch(self, camera_indices: Iterable[int], frame: int, needed_from: int) -> None:
        """Asks for the pictures and masks of `frame` to be read ahead, and does not wait.

        needed_from: the first frame that will be asked for again; only what is held of frames
        before it may be dropped to make room. Where there is no room, or too many requests wait,
        nothing is read ahead. What cannot be read is left out too: `image` will try again and
        raise.
        """
        self._check_frame(frame)
        for camera_index in camera_indices:
            if not self._prefetcher.ask(_Request(camera_index, frame, needed_from)):
                with self._lock:
                    self._dropped += 1

    @property
    def statistics(self) -> CacheStatistics:
        with self._lock:
            return CacheStatistics(
                self._hits,
                self._misses,
                self._evictions,
                self._held_bytes,
                self._prefetched,
                self._dropped,
                self._skipped,
                self._failed,
            )

    def close(self) -> None:
        """Ends the thread that reads ahead, frees the decoders and the pictures. Idempotent; a
        later request reads anew."""
        self._prefetcher.close()
        for lock, source in zip(self._source_locks, self._sources, strict=True):
            with lock:
                source.close()
        with self._lock:
            self._held.clear()
            self._held_bytes = 0

    def __enter__(self) -> FrameCache:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _check_frame(self, frame: int) -> None:
        if frame not in self.frames:
            raise InvalidError(f"frame {frame}: outside {self.frames.start}:{self.frames.stop}")

    def _mask_key(self, camera_index: int, frame: int) -> _Key | None:
        masks = self.capture.cameras[camera_index].masks
        if masks is None:
            return None
        # A mask for all frames is held once, as of the last frame: it is never out of date.
        return _Key(camera_index, self.frames[-1] if masks.is_still else frame, True)

    def _get(self, key: _Key) -> Bytes:
        held = self._look_up(key)
        if held is not None:
            return held
        with self._source_locks[key.camera]:
            held = self._look_up(key)  # another thread may have read it meanwhile
            if held is not None:
                return held
            read = self._read(key)
            with self._lock:
                self._misses += 1
                self._make_room(read.nbytes)
                self._keep(key, read)
            return read

    def _read(self, key: _Key) -> Bytes:
        """Needs the camera's lock."""
        camera = self._cameras[key.camera]
        masks = self.capture.cameras[key.camera].masks
        if key.is_mask and masks is not None:
            read = scaled_mask(masks.read(key.frame), camera.width_px, camera.height_px)
        else:
            read = scaled_picture(self._sources[key.camera].read(key.frame), camera)
        read.setflags(write=False)
        return read

    def _read_ahead(self, request: _Request) -> None:
        mask_key = self._mask_key(request.camera, request.frame)
        for key in (_Key(request.camera, request.frame), mask_key):
            if key is not None:
                self._read_key_ahead(key, request.needed_from)

    def _read_key_ahead(self, key: _Key, needed_from: int) -> None:
        camera = self._cameras[key.camera]
        num_bytes = (1 if key.is_mask else 3) * camera.width_px * camera.height_px
        with self._source_locks[key.camera]:
            with self._lock:
                if key in self._held:
                    return
                # Before reading: a video that reads a frame without room for it has to go back.
                if not self._has_room(num_bytes, needed_from):
                    self._skipped += 1
                    return
            try:
                read = self._read(key)
            except Exception:  # whatever it is, a request for the picture must raise it
                with self._lock:
                    self._failed += 1
                return
            with self._lock:
                if not self._has_room(num_bytes, needed_from):
                    self._skipped += 1
                    return
                self._prefetched += 1
                self._make_room(num_bytes, needed_from)
                self._keep(key, read)

    def _look_up(self, key: _Key) -> Bytes | None:
        with self._lock:
            held = self._held.get(key)
            if held is not None:
                self._held.move_to_end(key)
                self._hits += 1
            return held

    def _has_room(self, num_bytes: int, needed_from: int) -> bool:
        """Whether it fits beside what is needed. Needs the lock."""
        needed = sum(a.nbytes for key, a in self._held.items() if key.frame >= needed_from)
        return needed + num_bytes <= self._max_bytes

    def _make_room(self, num_bytes: int, needed_from: int | None = None) -> None:
        """Drops the least recently used, only of frames before `needed_from` if that is given.
        Needs the lock."""
        for key in tuple(self._held):
            if self._held_bytes + num_bytes <= self._max_bytes:
                return
            if needed_from is None or key.frame < needed_from:
                self._held_bytes -= self._held.pop(key).nbytes
                self._evictions += 1

    def _keep(self, key: _Key, read: Bytes) -> None:
        """Needs the lock."""
        self._held[key] = read
        self._held_bytes += read.nbytes


class Pictures(Protocol):
    """Pictures of frames 0..num_frames-1 of the training cameras."""

    @property
    def num_frames(self) -> int: ...

    @property
    def cameras(self) -> Sequence[Camera]: ...

    def shot(self, camera: int, frame: int) -> Shot:
        """The picture, of the camera's size, and its mask."""
        ...

    def mask(self, camera: int, frame: int) -> Mask | None:
        """The shot's mask alone: reads no picture."""
        ...


class CapturePictures:
    """The training cameras of a cache; its first frame is frame 0."""

    def __init__(self, cache: FrameCache, indices: Sequence[int]) -> None:
        """indices: of the training cameras, in the capture."""
        self._cache, self._indices = cache, indices
        self._cameras = [cache.camera(i) for i in indices]

    @property
    def num_frames(self) -> int:
        return len(self._cache.frames)

    @property
    def cameras(self) -> Sequence[Camera]:
        return self._cameras

    def shot(self, camera: int, frame: int) -> Shot:
        return self._cache.shot(self._indices[camera], self._cache.frames[frame])

    def mask(self, camera: int, frame: int) -> Mask | None:
        return self._cache.mask(self._indices[camera], self._cache.frames[frame])

    def prefetch(self, frame: int, needed_from: int) -> None:
        """Has a frame read ahead, if there is one; frames before `needed_from` may go for it."""
        if frame < self.num_frames:
            frames = self._cache.frames
            self._cache.prefetch(self._indices, frames[frame], frames[needed_from])
