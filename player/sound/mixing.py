"""Sources to stereo, as a listener at the camera hears them.

Rule: pure. A source at a place is as in WebAudio's PannerNode with its defaults: panned with equal
power, and beyond 1 m as much softer as it is farther. The others are heard as they are.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from codec.camera import Camera
from codec.stream.sound import SoundSource

Stereo = npt.NDArray[np.float32]
"""(n, 2), left and right, -1..1."""

REFERENCE_M = 1.0
"""A source is at its full loudness up to this distance."""

Gains = tuple[float, float]
"""Gains of the left and of the right ear."""


def gains_of(source: SoundSource, time_s: float, camera: Camera) -> Gains:
    """The gains of `source` at `time_s` of the stream for a listener at `camera`, who looks along
    it."""
    place = source.position_m(time_s)
    if place is None:
        return 1.0, 1.0
    right, down, forward = camera.w2c[:3, :3] @ np.asarray(place) + camera.w2c[:3, 3]
    distance_m = math.hypot(right, down, forward)
    across_m = math.hypot(right, forward)
    # In front and behind are the same for two ears.
    azimuth = math.asin(max(-1.0, min(1.0, right / across_m))) if across_m > 1e-9 else 0.0
    share = azimuth / math.pi + 0.5
    gain = REFERENCE_M / max(distance_m, REFERENCE_M)
    return gain * math.cos(share * math.pi / 2), gain * math.sin(share * math.pi / 2)


@dataclass(frozen=True, slots=True)
class SourcePiece:
    """Some samples of one source, and how loud they are at the first and after the last."""

    samples: npt.NDArray[np.int16]
    """(n, channels)."""
    begin: Gains
    end: Gains


def mix(pieces: Sequence[SourcePiece], num_samples: int) -> Stereo:
    """The sum of `pieces`, each of `num_samples`, not limited."""
    mixed = np.zeros((num_samples, 2), np.float32)
    for piece in pieces:
        samples = piece.samples.astype(np.float32) / 32768
        if piece.begin == piece.end:
            mixed += samples * np.array(piece.begin, np.float32)
        else:
            ramp = np.linspace(piece.begin, piece.end, num_samples, endpoint=False)
            mixed += samples * ramp.astype(np.float32)
    return mixed


def to_int16(mixed: Stereo) -> npt.NDArray[np.int16]:
    """`mixed` in 16 bits; what is louder is clipped."""
    return np.rint(np.clip(mixed * 32768, -32768, 32767)).astype(np.int16)
