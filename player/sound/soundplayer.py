"""The samples for the sound device, block by block, from where the playback is.

Rule: pure but for its clock; the device and the thread that fetches are elsewhere.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from codec.camera import Camera
from codec.stream.sound import SAMPLE_RATE
from player.playout.mediatime import DeviceTime

from .decodedsound import DecodedSound
from .mixing import Stereo, to_int16
from .splicer import HOP, Splicer

MediaAt = Callable[[float], tuple[float, float] | None]
"""Gives the frame, with its fraction, that is due at a time, and the rate; None while the picture
stands. See `Conductor.media_at`."""


class SoundPlayer:
    """One playback's sound. `pull` belongs to the device's thread; the rest may be set by any."""

    def __init__(
        self,
        decoded: DecodedSound,
        fps: float,
        time: DeviceTime,
        media_at: MediaAt,
        camera: Camera,
        volume: float = 1.0,
    ) -> None:
        self._fps, self._time, self._media_at = fps, time, media_at
        self._decoded = decoded
        self._splicer = Splicer(self._read)
        self._rest: Stereo = np.zeros((0, 2), np.float32)
        self.camera = camera
        """The listener is here, and looks along it."""
        self.volume = volume
        """0 to 1."""
        self.muted = False
        self.missing_s = 0.0
        """Seconds that were to be heard before their segment was there."""

    def _read(self, begin: int, stop: int) -> Stereo:
        return self._decoded.mix(begin, stop, self.camera)

    def pull(self, count: int, latency_s: float) -> npt.NDArray[np.int16]:
        """(count, 2) the next samples; the first is heard `latency_s` from now."""
        begin_s = self._time.pulled(count / SAMPLE_RATE, latency_s)
        pieces, have = [self._rest], len(self._rest)
        while have < count:
            due = self._media_at(begin_s + have / SAMPLE_RATE)
            frame, rate = due or (None, 1.0)
            sample = None if frame is None else frame * SAMPLE_RATE / self._fps
            if sample is not None:
                is_there = self._decoded.has(self._decoded.segment_at(int(sample)))
                self.missing_s += 0.0 if is_there else HOP / SAMPLE_RATE
            pieces.append(self._splicer.hop(sample, rate))
            have += HOP
        samples = np.concatenate(pieces)
        self._rest = samples[count:]
        return to_int16(samples[:count] * (0.0 if self.muted else self.volume))
