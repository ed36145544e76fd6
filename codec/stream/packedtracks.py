"""What the index of a packed stream does not know: the sizes of its captions and its sound.

Rule: pure. The length of the table follows from manifest and index; the head of the file repeats
it, because a reader needs it first.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from codec.arrays import Longs
from codec.errors import CorruptError

from .captions import MAX_CAPTIONS_BYTES
from .manifest import Manifest
from .sound import MAX_SOUND_BYTES

TRACKS_NAME = ".tracks"
"""The name of the table in the file: of a folder, readers ignore such a name."""

_SIZE = np.dtype("<u4")


def tracks_bytes(manifest: Manifest, num_segments: int) -> int:
    """The size of the table of such a stream; 0 without captions and sound."""
    return _SIZE.itemsize * (len(manifest.captions) + num_segments * len(manifest.sound))


@dataclass(frozen=True, slots=True)
class TrackSizes:
    """The table. All numbers are bytes."""

    captions: tuple[int, ...]
    """Of each file of captions, in the manifest's order."""
    sound: Longs
    """(segments, sources) of each object of sound, the sources in the manifest's order."""

    def to_bytes(self) -> bytes:
        sizes = np.concatenate([np.array(self.captions, np.int64), self.sound.ravel()])
        return sizes.astype(_SIZE).tobytes()

    @staticmethod
    def parse(data: bytes, manifest: Manifest, num_segments: int) -> TrackSizes:
        """The table in `data`. Raises CorruptError."""
        wanted = tracks_bytes(manifest, num_segments)
        if len(data) != wanted:
            raise CorruptError(
                f"packed stream: {len(data)} bytes for the sizes of captions and sound, but by its "
                f"manifest and index they take {wanted}",
                0,
            )
        sizes = np.frombuffer(data, _SIZE).astype(np.int64)
        count = len(manifest.captions)
        limits = np.full(len(sizes), MAX_SOUND_BYTES)
        limits[:count] = MAX_CAPTIONS_BYTES
        wrong = np.flatnonzero((sizes < 1) | (sizes > limits))
        if len(wrong):
            at = int(wrong[0])
            what = "captions" if at < count else "sound"
            raise CorruptError(f"packed stream: {what} of {sizes[at]} bytes", at * _SIZE.itemsize)
        sound = sizes[count:].reshape(num_segments, len(manifest.sound))
        return TrackSizes(tuple(map(int, sizes[:count])), sound)
