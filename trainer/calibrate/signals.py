"""What takes have in common that tells when each began: sound, timecode, movement."""

from __future__ import annotations

import re
from contextlib import closing
from pathlib import Path

import av
import numpy as np
from PIL import Image
from scipy.ndimage import uniform_filter

from codec.arrays import Doubles
from codec.errors import SwingsError
from codec.stream.sound import SAMPLE_RATE
from codec.tracks.soundfile import read_samples

from .takes import Take

SOUND_RATE = 1000
"""Loudnesses a second: a millisecond, in which sound travels 34 cm."""

QUIET = 20.0
"""Root mean square, of 32768, below which a take has no sound to speak of."""

SMALL_PX, REACH, MOVING = 96, 7, 3.0
"""Side of the small pictures in which movement is looked for, samples of them around its middle
that belong to it, and their mean change, of 255, from which on something moves there."""

_TIMECODE = re.compile(r"(\d\d):(\d\d):(\d\d)[:;.](\d\d)")


def onsets(file: Path, most_s: float) -> Doubles | None:
    """(T,) how the loudness of a take rises, SOUND_RATE times a second from its first picture on;
    None for one without sound. Onsets are alike at all microphones, where the wave itself is not.
    """
    blocks: list[Doubles] = []
    count, step = 0, SAMPLE_RATE // SOUND_RATE
    try:
        for piece in read_samples(file, 1):
            blocks.append(piece[:, 0].astype(np.float64))
            count += len(piece)
            if count > most_s * SAMPLE_RATE:
                break
    except (SwingsError, av.FFmpegError):
        return None
    if count < SAMPLE_RATE:
        return None
    whole = np.concatenate(blocks)[: count // step * step].reshape(-1, step)
    power = ((whole - whole.mean()) ** 2).mean(axis=1)
    if np.sqrt(power.mean()) < QUIET:
        return None
    smooth = np.convolve(power, np.hanning(7) / np.hanning(7).sum(), "same")
    rise: Doubles = np.diff(np.log(smooth + 0.01 * smooth.mean() + 1.0))
    return np.maximum(rise, 0)


def timecode_s(file: Path, fps: float) -> float | None:
    """The time of day, seconds, at which a video says that it begins; None if it does not."""
    try:
        with av.open(f"file:{file}", options={"protocol_whitelist": "file"}) as container:
            told = [container.metadata, *(stream.metadata for stream in container.streams)]
    except av.FFmpegError:
        return None
    for text in (metadata.get("timecode", "") for metadata in told):
        found = _TIMECODE.fullmatch(text.strip())
        if found:
            hours, minutes, seconds, frames = map(int, found.groups())
            return 3600 * hours + 60 * minutes + seconds + frames / round(fps)
    return None


def movement_px(take: Take, rate: float, most_s: float) -> Doubles:
    """(T, 2) where most moves in a take, `rate` times a second, pixels; NaN where nothing does."""
    count = int(min(most_s, take.times_s[-1]) * rate) + 1
    found = np.full((count, 2), np.nan)
    before, last = None, -1
    with closing(take.open()) as source:
        for sample in range(count):
            frame = take.nearest_frame(sample / rate)
            if frame == last:  # a video of a lower rate shows some twice
                continue
            last, image = frame, Image.fromarray(source.read(frame)).convert("L")
            grey = np.asarray(image.resize((SMALL_PX, SMALL_PX), Image.Resampling.BOX), np.float64)
            if before is not None:
                found[sample] = _place_of(np.abs(grey - before))
            before = grey
    pixels: Doubles = found / SMALL_PX * (take.width_px, take.height_px)
    return pixels


def _place_of(difference: Doubles) -> Doubles:
    """(2,) x and y of the middle of what changes most, in samples of the difference."""
    smooth = uniform_filter(difference, REACH, mode="constant")
    peak = int(np.argmax(smooth))
    if smooth.flat[peak] < MOVING:
        return np.full(2, np.nan)
    row, column = divmod(peak, difference.shape[1])
    top, left = max(0, row - REACH), max(0, column - REACH)
    weights = difference[top : row + REACH + 1, left : column + REACH + 1] ** 2
    y, x = np.indices(weights.shape) + 0.5
    middle = np.array([(x * weights).sum(), (y * weights).sum()]) / weights.sum()
    place: Doubles = middle + np.array([left, top])
    return place
