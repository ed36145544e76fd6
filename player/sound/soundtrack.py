"""The sound of a capture: of each frame that is drawn, for the camera that draws it."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from codec.camera import Camera
from codec.stream.manifest import Manifest
from codec.stream.sound import first_sample

from .decodedsound import DecodedSound, ReadSound, SegmentLoader
from .mixing import to_int16


class SoundTrack:
    """Pieces of sound, one for each frame, of frames in any order. What cannot be read is an
    error."""

    def __init__(
        self, manifest: Manifest, read: ReadSound, num_frames: int, volume: float = 1.0
    ) -> None:
        """num_frames: of the stream, as far as it is known."""
        self._manifest, self._num_frames, self._volume = manifest, num_frames, volume
        self._loader = SegmentLoader(manifest, read)
        self._decoded = DecodedSound(manifest)
        self._pieces = 0
        self._written = 0  # samples

    def piece(self, frame: int, camera: Camera, then: Camera) -> npt.NDArray[np.int16]:
        """(n, 2) what is heard with the next picture, which shows `frame` from `camera`; the one
        after it is drawn from `then`. Raises a SwingsError.

        However often frames repeat, the pieces before picture n have first_sample(n) samples.
        """
        fps = self._manifest.fps
        self._pieces += 1
        count = first_sample(self._pieces, fps) - self._written
        self._written += count
        begin, stop = first_sample(frame, fps), first_sample(frame + 1, fps)
        self._load(frame // self._manifest.segment_frames)
        mixed = self._decoded.mix(begin, stop, camera, then)
        # Where frames repeat, one may be a sample shorter or longer than the picture.
        there = np.minimum(np.arange(count), len(mixed) - 1)
        return to_int16(mixed[there] * self._volume)

    def _load(self, segment: int) -> None:
        if not self._decoded.has(segment):
            self._decoded.keep(())
            self._decoded.put(segment, self._loader.load(segment, self._num_frames))
