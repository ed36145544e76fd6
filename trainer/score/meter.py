"""The quality of a stream while it is written: how its decoded slices look, layer by layer."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from statistics import fmean

from codec.slice import Slice, active_splats
from codec.stream import StreamReader
from codec.stream.manifest import Manifest
from trainer.pictures.framecache import FrameCache

from .picture import score_splats


class QualityMeter:
    """Scores every frame of one stream with 1, 2, ... layers, as it will be decoded.

    The capture's `watching` cameras take turns, one for a frame: so much the index knows. The
    first frame is scored from all of them, so that `mean_db` is about all from the beginning.
    """

    def __init__(self, cache: FrameCache, manifest: Manifest) -> None:
        self._cache = cache
        self._manifest = manifest
        self._cameras = cache.capture.watching
        # One window for each number of layers.
        self._windows: list[deque[Slice]] = [
            deque(maxlen=manifest.swin_size) for _ in manifest.layers
        ]
        self._newest_db: dict[int, float] = {}  # of each camera, with all layers

    @property
    def mean_db(self) -> float | None:
        """Mean over the cameras of the newest PSNR of each, with all layers; None before the first
        frame."""
        return fmean(self._newest_db.values()) if self._newest_db else None

    def recall(self, reader: StreamReader, next_birth: int) -> None:
        """Takes in what lies on disk of the window before `next_birth`."""
        manifest = self._manifest
        first = max(manifest.first_birth, next_birth - manifest.swin_size)
        for birth in range(first, next_birth):
            for layers, window in enumerate(self._windows, start=1):
                window.append(reader.slice(birth, layers))

    def __call__(self, frame: int, slices: Sequence[Slice]) -> list[float] | None:
        """PSNR in dB of `frame`, in which `slices` are born: the same slice with 1, 2, ... layers;
        None before frame 0, and where no pixel of the camera counts."""
        for window, slice in zip(self._windows, slices, strict=True):
            window.append(slice)
        if frame < 0:
            return None
        turn = frame % len(self._cameras)
        if not self._newest_db:
            for camera in (*self._cameras[:turn], *self._cameras[turn + 1 :]):
                self._score(camera, frame, self._windows[-1:])
        return self._score(self._cameras[turn], frame, self._windows)

    def _score(
        self, camera: int, frame: int, windows: Sequence[deque[Slice]]
    ) -> list[float] | None:
        """PSNR of `frame` from a camera, for each of `windows`, of which the last has all layers;
        None where no pixel counts."""
        shot = self._cache.shot(camera, self._cache.frames[frame])
        if shot.mask is not None and not shot.mask.any():
            return None
        scores_db = []
        for window in windows:
            splats = active_splats(window, frame, self._manifest.swin_size)
            view = self._cache.camera(camera)
            score = score_splats(splats, view, shot, self._manifest.near_of(view))
            scores_db.append(score.psnr_db)
        self._newest_db[camera] = scores_db[-1]
        return scores_db
