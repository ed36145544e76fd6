"""The sound of a trained stream: a file's, or that of the capture's videos, aligned to its frames.

Rule: it is encoded before training begins, so that a bad file ends the run at once; each segment
gets its packets when it is written.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

from codec.errors import InvalidError, SwingsError
from codec.stream.sound import (
    DEFAULT_BITRATE_BPS,
    SAMPLE_RATE,
    SoundObject,
    SoundSource,
    first_sample,
    segment_sound,
)
from codec.tracks.soundfile import Samples, encode, read_samples, shifted
from trainer.capture.capture import Capture
from trainer.storedfiles import block_file, by_its_name, translated

from .config import TrainConfig

log = logging.getLogger(__name__)

SOURCE = SoundSource("main", 2)
"""The one source of a trained stream; swings-stream audio adds others."""


@dataclass(frozen=True, slots=True)
class CaptureSound:
    """The encoded sound of a capture, whole, to be cut into the segments of its stream."""

    whole: SoundObject
    fps: float

    def objects(self, first_frame: int, end_frame: int) -> Mapping[str, bytes]:
        """The objects of a segment of the stream, by their names. Raises InvalidError."""
        begin, stop = first_sample(first_frame, self.fps), first_sample(end_frame, self.fps)
        return {SOURCE.part: segment_sound(self.whole, begin, stop).pack()}


def capture_sound(
    config: TrainConfig, capture: Capture, frames: range, fps_of: Callable[[], float]
) -> CaptureSound | None:
    """The sound of `frames` of the capture: of `config.audio` from the capture's frame 0 on, else
    of the first of its videos that has any; None without. fps_of: of the stream; is called where
    there is sound. Raises a SwingsError for a file that was asked for; a video whose sound cannot
    be read is logged and left out."""
    if config.audio is not None:
        return _encoded(config.audio, frames, fps_of())
    if config.silent:
        return None
    starts_s = capture.starts_s or (0.0,) * len(capture.videos)
    for video, start_s in zip(capture.videos, starts_s, strict=True):
        try:
            if not _has_sound(video):
                continue
            found = _encoded(video, frames, fps_of(), start_s)
        except SwingsError as error:
            log.warning("the sound of a video is left out: %s", error)
            continue
        log.info("the stream gets the sound of %s", video)
        return found
    return None


def _encoded(file: Path, frames: range, fps: float, start_s: float = 0.0) -> CaptureSound:
    """start_s: the time in the file at which frame 0 is."""
    offset_s = -start_s - first_sample(frames.start, fps) / SAMPLE_RATE
    pieces = shifted(_samples(file), SOURCE.channels, offset_s)
    length = first_sample(len(frames), fps)
    return CaptureSound(encode(pieces, SOURCE.channels, length, DEFAULT_BITRATE_BPS), fps)


def _has_sound(video: Path) -> bool:
    try:
        return any(len(piece) for piece in islice(_samples(video), 1))
    except InvalidError:
        return False


def _samples(file: Path) -> Iterator[Samples]:
    """The samples of `file`, which may lie in an object store; see `read_samples`."""
    with by_its_name(file), translated():
        yield from read_samples(file, SOURCE.channels, block_file(file))
