"""Sound for small streams: clicks at the beginnings of frames."""

from __future__ import annotations

import wave
from collections.abc import Sequence
from pathlib import Path

import av
import numpy as np
import numpy.typing as npt

from codec.stream import StreamReader
from codec.stream.sound import SAMPLE_RATE, Key, SoundSource, first_sample
from codec.tracks.streamtracks import add_sound, samples

BURST = (20000 * np.sin(np.arange(480) * 2 * np.pi / 24)).astype(np.int16)
"""A click: 10 ms of 2 kHz."""


def write_wav(path: Path, samples: npt.NDArray[np.int16]) -> None:
    """Writes (n, channels) samples."""
    with wave.open(str(path), "wb") as file:
        file.setnchannels(samples.shape[1])
        file.setsampwidth(2)
        file.setframerate(SAMPLE_RATE)
        file.writeframes(samples.astype("<i2").tobytes())


def write_clicks(path: Path, num_samples: int, at: Sequence[int], channels: int = 2) -> None:
    """Writes a WAV file of `num_samples` with a BURST from each sample of `at` on."""
    data = np.zeros((num_samples, channels), np.int16)
    for begin in at:
        piece = data[begin : begin + len(BURST)]
        piece[:] = BURST[: len(piece), None]
    write_wav(path, data)


def add_clicks(
    stream: Path, frames: Sequence[int], name: str = "main", keys: Sequence[Key] = ()
) -> None:
    """Adds a source that clicks at the beginning of `frames` to the stream in a folder."""
    reader = StreamReader(stream)
    fps, channels = reader.manifest.fps, 1 if keys else 2
    file = stream.parent / f"{stream.name}-{name}.wav"
    at = [first_sample(frame, fps) for frame in frames]
    write_clicks(file, first_sample(reader.num_frames, fps), at, channels)
    add_sound(stream, file, SoundSource(name, channels, tuple(keys)))


def heard(stream: Path, name: str = "main") -> npt.NDArray[np.int16]:
    """(n, channels) samples of a source."""
    reader = StreamReader(stream)
    source = next(one for one in reader.manifest.sound if one.name == name)
    return np.concatenate(list(samples(reader, source)))


def track_of(video: Path) -> npt.NDArray[np.int16]:
    """(n, 2) samples of a video's sound track."""
    with av.open(str(video)) as container:
        resampler = av.AudioResampler("s16", "stereo", SAMPLE_RATE)
        pieces = []
        for frame in container.decode(audio=0):
            pieces += [piece.to_ndarray().reshape(-1, 2) for piece in resampler.resample(frame)]
    return np.concatenate(pieces)


def best_shift(a: npt.NDArray[np.int16], b: npt.NDArray[np.int16], most: int) -> int:
    """Delay of `b` relative to `a` at their best match, samples; both have the same length."""
    x, y = a.astype(float), b.astype(float)
    inner = slice(most, len(x) - most)
    scores = [float(np.sum(x[inner] * np.roll(y, -n, 0)[inner])) for n in range(-most, most + 1)]
    return int(np.argmax(scores)) - most
