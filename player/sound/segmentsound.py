"""Objects of sound to samples: those of one source, a segment at a time.

Rule: pure. Bytes come in, samples go out.
"""

from __future__ import annotations

from itertools import accumulate

import numpy as np

from codec.errors import CorruptError, UnsupportedError
from codec.stream.manifest import Manifest
from codec.stream.sound import (
    MAX_PACKET_SAMPLES,
    PREROLL,
    SAMPLE_RATE,
    SoundObject,
    SoundSource,
    first_sample,
    packet_samples,
)
from codec.tracks.soundfile import PacketDecoder, Samples

MAX_SEGMENT_S = 1200
"""Seconds of sound in a segment, of all channels of all sources together. More is not played: all
samples of a segment are held."""


def check_playable(manifest: Manifest) -> None:
    """Raises UnsupportedError for segments of too much sound to hold their samples."""
    channels = sum(source.channels for source in manifest.sound)
    _, stop = segment_span(manifest, 0)
    if channels * stop > MAX_SEGMENT_S * SAMPLE_RATE:
        raise UnsupportedError(
            f"its segments of {manifest.segment_frames} frames hold {channels} channels of sound, "
            f"more than {MAX_SEGMENT_S} s together; play it with --mute"
        )


def segment_span(manifest: Manifest, segment: int) -> tuple[int, int]:
    """The samples that are heard with `segment`, if it is whole: the first, and the one after the
    last."""
    first_frame = segment * manifest.segment_frames
    end_frame = first_frame + manifest.segment_frames
    return first_sample(first_frame, manifest.fps), first_sample(end_frame, manifest.fps)


class SegmentDecoder:
    """The decoder of one source. A segment that follows the one before goes on from its state; any
    other one begins with its own packets."""

    def __init__(self, source: SoundSource, manifest: Manifest) -> None:
        self._source, self._manifest = source, manifest
        self._segment = -1  # the one that was decoded last
        self._end = 0  # position where the next packet is to begin
        self._decoder = PacketDecoder(source.channels)
        self._tail: Samples = np.zeros((0, source.channels), np.int16)  # before `_end`

    def decode(self, segment: int, data: bytes, end_frame: int = 0) -> Samples:
        """All samples of `segment`, (n, channels), with the object `data`; silence where the source
        or its packets have ended. end_frame: the frames before it are in the stream, so that their
        sound must be there. Raises CorruptError."""
        found = SoundObject.parse(data)
        if found.channels != self._source.channels:
            raise CorruptError(f"sound: {found.channels} channels, not {self._source.channels}", 12)
        begin, stop = segment_span(self._manifest, segment)
        # The last segment is shorter; which one that is, is not known while the stream is live.
        known = max(first_sample(end_frame, self._manifest.fps), found.end - found.pre_skip)
        found.check_covers(begin, min(stop, known))
        samples = np.zeros((stop - begin, found.channels), np.int16)
        last = min(stop, found.num_samples)
        # Packets before the first of these positions, and after the other, are not needed: a
        # stranger may send very many of them.
        least, most = begin + found.pre_skip - PREROLL, last + found.pre_skip
        starts = list(accumulate(map(packet_samples, found.packets), initial=found.first))
        goes_on = segment == self._segment + 1 and max(starts[0], least) <= self._end <= starts[-1]
        if not goes_on:
            self._decoder, self._tail = PacketDecoder(found.channels), samples[:0]
            self._end = max((at for at in starts if at <= least), default=found.first)
        pieces = [self._tail]
        for at, packet in zip(starts, found.packets, strict=False):
            if at == self._end and at < most:
                pieces.append(self._decoder.decode(packet))
                self._end += len(pieces[-1])
        decoded = np.concatenate(pieces)
        self._segment = segment
        # The next segment begins in the last packet.
        self._tail = decoded[max(0, len(decoded) - MAX_PACKET_SAMPLES) :]
        from_sample = self._end - len(decoded) - found.pre_skip
        there = decoded[max(0, begin - from_sample) : max(0, last - from_sample)]
        offset = max(0, from_sample - begin)
        samples[offset : offset + len(there)] = there
        return samples
