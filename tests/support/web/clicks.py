"""Sound that can be told apart from silence to a sample, and streams with it."""

from __future__ import annotations

import wave
from pathlib import Path

import numpy as np

from codec.stream.reader import StreamReader
from codec.stream.sound import SAMPLE_RATE, SoundSource, first_sample
from codec.tools.static import export_static
from codec.tools.streamsound import add_sound
from tests.support.hosted_streams import SLICE_SIZE, write_stream

CLICK_FRAMES = 15
"""Frames from click to click, the first one with frame 0."""

CLICK_SAMPLES = 480


def write_click_file(path: Path, num_frames: int, fps: float) -> Path:
    """A WAV file of bursts of 10 ms, one every CLICK_FRAMES frames."""
    data = np.zeros(first_sample(num_frames, fps), np.int16)
    burst = 25000 * np.sin(np.arange(CLICK_SAMPLES) * 2 * np.pi / 24)
    for frame in range(0, num_frames, CLICK_FRAMES):
        part = data[first_sample(frame, fps) :][:CLICK_SAMPLES]
        part[:] = burst[: len(part)]
    with wave.open(str(path), "wb") as file:
        file.setnchannels(1)
        file.setsampwidth(2)
        file.setframerate(SAMPLE_RATE)
        file.writeframes(data.astype("<i2").tobytes())
    return path


def write_clicking_stream(
    folder: Path, num_frames: int, *sources: SoundSource, slice_size: int = SLICE_SIZE
) -> Path:
    """A static export with clicks from each of `sources`, in `folder`/static."""
    stream = write_stream(folder / "trained", num_frames, slice_size)
    fps = StreamReader(stream).manifest.fps
    clicks = write_click_file(folder / "clicks.wav", num_frames, fps)
    for source in sources:
        add_sound(stream, clicks, source)
    export_static(stream, folder / "static")
    return folder / "static"
