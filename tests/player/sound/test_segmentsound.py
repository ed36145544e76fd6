"""Segments of sound from any writer: decoded only as far as they are heard."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from codec.errors import CorruptError, UnsupportedError
from codec.stream.sound import (
    MAX_PACKET_SAMPLES,
    MAX_PACKETS,
    SAMPLE_RATE,
    SoundObject,
    SoundSource,
    first_sample,
    packet_samples,
    segment_sound,
)
from codec.tracks.soundfile import PACKET_SAMPLES, decode, encode
from player.sound.feed import MAX_SEGMENT_S, SegmentDecoder, check_playable, segment_span
from tests.support.hosted_streams import small_manifest
from tests.support.hostile import within_bytes

MAIN = SoundSource("main", 2)
MANIFEST = replace(small_manifest(), sound=(MAIN,))
SILENCE = bytes([0x0B, 0x06])
"""The longest possible packet in the fewest bytes: six frames of 20 ms."""


def silent_object(num_packets: int, num_samples: int) -> SoundObject:
    assert packet_samples(SILENCE) == MAX_PACKET_SAMPLES
    return SoundObject(2, 312, num_samples, 0, (SILENCE,) * num_packets)


def test_packets_far_behind_the_segment_are_refused() -> None:
    for num_samples, segment in ((0, 0), (1 << 40, 0), (1 << 40, 7)):
        whole = silent_object(MAX_PACKETS, num_samples).pack()
        with pytest.raises(CorruptError, match="sound: packets up to"):
            SegmentDecoder(MAIN, MANIFEST).decode(segment, whole)


@pytest.mark.parametrize("more_frames", [-2, 0, 9])
def test_the_last_segment_may_be_short_whatever_the_length_of_the_source(more_frames: int) -> None:
    num_frames = 3 * MANIFEST.segment_frames + 2
    length = first_sample(num_frames + more_frames, MANIFEST.fps)
    sound = np.random.default_rng(1).integers(-9000, 9000, (length, 2)).astype(np.int16)
    whole = encode([sound], 2, length, 96000)
    expected = np.concatenate(list(decode(whole.packets, 2)))[whole.pre_skip :][:length]
    decoder = SegmentDecoder(MAIN, MANIFEST)
    for segment in range(4):
        begin, end = segment_span(MANIFEST, segment)
        stop = min(end, first_sample(num_frames, MANIFEST.fps))
        data = segment_sound(whole, begin, stop).pack()
        samples = decoder.decode(segment, data)
        there = expected[begin:stop]
        assert len(samples) == end - begin
        np.testing.assert_array_equal(samples[: len(there)], there)
        # The last packet is heard, and silence after it.
        assert not samples[stop - begin + PACKET_SAMPLES :].any()


def test_packets_far_before_the_segment_are_not_decoded() -> None:
    num_packets, segment = 3000, 0
    while segment_span(MANIFEST, segment)[1] < (num_packets - 2) * MAX_PACKET_SAMPLES:
        segment += 1
    whole = silent_object(num_packets, 1 << 40)
    short = silent_object(0, 0)
    begin, stop = segment_span(MANIFEST, segment)
    decoder = SegmentDecoder(MAIN, MANIFEST)
    with within_bytes(4_000_000):  # all samples have 69 MB
        assert decoder.decode(segment, whole.pack()).shape == (stop - begin, 2)
        # A source that had ended, and continues after all.
        assert not decoder.decode(segment - 1, short.pack()).any()
        assert decoder.decode(segment, whole.pack()).shape == (stop - begin, 2)


def test_segments_of_too_many_samples_are_not_played() -> None:
    manifest = small_manifest(fps=30.0, segment_frames=MAX_SEGMENT_S // 16 * 30)
    sources = tuple(SoundSource(f"s{n}", 1) for n in range(16))
    check_playable(replace(manifest, sound=sources))
    for wrong in (
        replace(manifest, sound=(*sources[1:], MAIN)),
        replace(manifest, sound=sources, segment_frames=manifest.segment_frames + 1),
    ):
        with pytest.raises(UnsupportedError, match="play it with --mute"):
            check_playable(wrong)
    assert np.int16(0).nbytes * MAX_SEGMENT_S * SAMPLE_RATE < 1.2e8
