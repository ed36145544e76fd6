"""The sound of a `--capture`, of each frame that is drawn for the camera that draws it, spliced to
one stream of samples without clicks.

Rule: `Splicer` is pure. At normal speed the samples pass unchanged. At other rates pieces overlap
where they are alike, so that the pitch is kept (WSOLA: Verhelst and Roelands, 1993). A jump is
cross-faded.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from codec.arrays import Doubles
from codec.camera import Camera
from codec.stream.manifest import Manifest
from codec.stream.sound import first_sample

from .feed import DecodedSound, ReadSound, SegmentLoader, Stereo, to_int16


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


HOP = 480
"""Samples that one piece adds, 10 ms; pieces are twice as long, and overlap."""

SLACK = 240
"""A piece goes on where the one before ends, if it is to begin no farther away than this."""

SEARCH = 240
"""Samples by which a piece may begin away from its place where the rate is not 1: half a period of
100 Hz."""

FADE = (0.5 - 0.5 * np.cos(np.pi * (np.arange(2 * HOP) + 0.5) / HOP)).astype(np.float32)[:, None]
"""(2 HOP, 1) the weight of a piece; that of two which overlap is 1."""

Read = Callable[[int, int], Stereo]
"""Gives samples from one to another; silence where there are none."""


class Splicer:
    """One listener's stream of samples."""

    def __init__(self, read: Read) -> None:
        self._read = read
        self._tail: Stereo = np.zeros((HOP, 2), np.float32)
        self._next: int | None = None  # where the last piece goes on

    def hop(self, sample: float | None, rate: float) -> Stereo:
        """(HOP, 2) the next samples out; `sample` is the one that is due with the first of them,
        None for silence. rate: how fast the samples pass."""
        if sample is None:
            out, self._next = self._tail, None
            self._tail = np.zeros((HOP, 2), np.float32)
            return out
        # The middle of a piece is in time, which passes in it as in the stream.
        begin = self._begin(round(sample + (rate - 1) * HOP), rate)
        piece = self._read(begin, begin + 2 * HOP) * FADE
        out = (self._tail + piece[:HOP]).astype(np.float32)
        self._tail, self._next = piece[HOP:], begin + HOP
        return out

    def _begin(self, wanted: int, rate: float) -> int:
        if self._next is None:
            return wanted
        if abs(wanted - self._next) <= SLACK:
            return self._next
        return wanted if rate == 1 else self._most_alike(wanted, self._next)

    def _most_alike(self, wanted: int, goes_on: int) -> int:
        """The sample near `wanted` from which on the stream is most like that from `goes_on` on."""
        model = self._read(goes_on, goes_on + HOP).sum(axis=1)
        around = self._read(wanted - SEARCH, wanted + SEARCH + HOP).sum(axis=1)
        energy: Doubles = np.cumsum(np.concatenate([[0.0], around**2]))
        energy = energy[HOP:] - energy[:-HOP]
        likeness = np.correlate(around, model, "valid") / np.sqrt(energy + 1e-6)
        return wanted - SEARCH + int(np.argmax(likeness)) if likeness.any() else wanted
