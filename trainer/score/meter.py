"""The quality of a stream while it is written: how its decoded slices look, layer by layer."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from statistics import fmean

from codec.slice import Slice, active_splats
from codec.stream import StreamReader
from codec.stream.manifest import Manifest
from trainer.pictures.framecache import FrameCache

from .truth import score_splats

MOST_CAMERAS = 8
"""Maximum cameras that are scored: where none is held out, all training cameras watch."""


class QualityMeter:
    """Scores the frames of one stream with 1, 2, ... layers, as it will be decoded.

    The capture's `watching` cameras take turns, one for a frame. In each segment, all of them have
    the same number of turns, or else the mean over a segment, which the index holds, would be about
    whose turn it was: frames that remain are not scored, and where there are more cameras than
    frames, the first frame is scored from all. So is frame 0, for `mean_db`.
    """

    def __init__(self, cache: FrameCache, manifest: Manifest) -> None:
        self._cache = cache
        self._manifest = manifest
        watching = cache.capture.watching
        self._cameras = watching[:: -(-len(watching) // MOST_CAMERAS)]
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
        None before frame 0, where no pixel of the camera counts, and where no camera has its
        turn."""
        for window, slice in zip(self._windows, slices, strict=True):
            window.append(slice)
        if frame < 0:
            return None
        cameras = self._turn(frame)
        if not self._newest_db:
            for camera in self._cameras:
                if camera not in cameras:
                    self._score(camera, frame, self._windows[-1:])
        scores_db = [self._score(camera, frame, self._windows) for camera in cameras]
        found = [score for score in scores_db if score is not None]
        return [fmean(column) for column in zip(*found, strict=True)] if found else None

    def _turn(self, frame: int) -> Sequence[int]:
        """The cameras from which a frame is scored."""
        segment_frames = self._manifest.segment_frames
        place = frame % segment_frames
        num_frames = min(segment_frames, len(self._cache.frames) - (frame - place))
        rounds = num_frames // len(self._cameras)
        if rounds == 0:
            return self._cameras if place == 0 else ()
        if place >= rounds * len(self._cameras):
            return ()
        return (self._cameras[place % len(self._cameras)],)

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
