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
        self, manifest: Manifest, num_frames: int, read: ReadSound, volume: float = 1.0
    ) -> None:
        """num_frames: of the stream, as far as it is known; what follows is silent."""
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
        begin = first_sample(frame, fps)
        self._load(begin, begin + count)
        return to_int16(self._decoded.mix(begin, begin + count, camera, then) * self._volume)

    def _load(self, begin: int, stop: int) -> None:
        decoded = self._decoded
        last = (self._num_frames - 1) // self._manifest.segment_frames
        wanted = range(decoded.segment_at(begin), min(last, decoded.segment_at(stop - 1)) + 1)
        decoded.keep(wanted)
        for segment in wanted:
            if not decoded.has(segment):
                decoded.put(segment, self._loader.load(segment))
