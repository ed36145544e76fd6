"""The samples for the sound device of this machine, block by block, from where the playback is; and
the device, by miniaudio, which no other file knows.
"""

from __future__ import annotations

import logging
import sys
from collections.abc import Callable, Generator
from pathlib import Path
from typing import Any

import miniaudio
import numpy as np
import numpy.typing as npt

from codec.camera import Camera
from codec.stream.sound import SAMPLE_RATE
from player.playout.clock import DeviceTime

from .feed import DecodedSound, Stereo, to_int16
from .soundtrack import HOP, Splicer

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


log = logging.getLogger(__name__)

PERIOD_MS = 20
"""The device asks for so much at a time."""

PERIODS = 3
"""So many of them wait to be heard."""

LATENCY_S = PERIOD_MS * (PERIODS - 1) / 1000
"""From when samples are asked for to when they are heard: after those that wait."""


def own_backends() -> list[Any] | None:
    """The backends to try on this system; None for miniaudio's choice. ALSA without a card would
    write many lines to standard error."""
    if sys.platform != "linux":
        return None
    alsa = [miniaudio.Backend.ALSA] if Path("/dev/snd").exists() else []
    return [miniaudio.Backend.PULSEAUDIO, *alsa]


def _blocks(player: SoundPlayer) -> Generator[bytes, int, None]:
    """The generator that miniaudio calls: it sends the number of samples."""
    count = yield b""
    while True:
        try:
            block = player.pull(count, LATENCY_S)
        except Exception:  # or the device's thread would print it again and again
            log.exception("the sound has failed; playing on without it")
            break
        count = yield block.tobytes()
    while True:
        count = yield np.zeros((count, 2), np.int16).tobytes()


class SoundDevice:
    """Plays what `player` gives while the `with` block runs."""

    def __init__(self, player: SoundPlayer, backends: list[Any] | None = None) -> None:
        """backends: of miniaudio.Backend, tried in turn; None for `own_backends`. Raises
        miniaudio.MiniaudioError where there is no device."""
        self._blocks = _blocks(player)
        next(self._blocks)
        self._device = miniaudio.PlaybackDevice(
            miniaudio.SampleFormat.SIGNED16,
            nchannels=2,
            sample_rate=SAMPLE_RATE,
            buffersize_msec=PERIOD_MS,
            callback_periods=PERIODS,
            backends=own_backends() if backends is None else backends,
            app_name="swings",
        )

    def __enter__(self) -> SoundDevice:
        """Raises miniaudio.MiniaudioError where the device does not start."""
        try:
            self._device.start(self._blocks)
        except miniaudio.MiniaudioError:
            self._device.close()
            raise
        return self

    def __exit__(self, *error: object) -> None:
        self._device.close()
