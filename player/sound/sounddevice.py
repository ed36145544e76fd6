"""The sound device of this machine, by miniaudio. The only file that knows it."""

from __future__ import annotations

import logging
import sys
from collections.abc import Generator
from pathlib import Path
from typing import Any

import miniaudio
import numpy as np

from codec.stream.sound import SAMPLE_RATE

from .soundplayer import SoundPlayer

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
