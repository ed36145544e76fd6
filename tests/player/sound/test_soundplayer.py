"""The samples that the sound device gets, and the count of those that were late."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from codec.stream.sound import SAMPLE_RATE, SoundSource
from player.playout.clock import DeviceTime
from player.sound.feed import DecodedSound, Stereo, segment_span
from player.sound.soundplayer import SoundPlayer
from player.sound.soundtrack import HOP, Splicer
from tests.support.hosted_streams import small_manifest

NUM_FRAMES = 20
"""Frames of the stream, in 4 segments."""


@pytest.mark.parametrize("lacking", [set(), {1}, {3}, {0, 1, 2, 3}])
@pytest.mark.parametrize("rate", [0.5, 1.0, 2.0])
def test_each_second_that_lacks_its_segment_counts_once(lacking: set[int], rate: float) -> None:
    manifest = replace(small_manifest(fps=30.0), sound=(SoundSource("main", 1),))
    decoded = DecodedSound(manifest)
    for segment in {0, 1, 2, 3} - lacking:
        begin, stop = segment_span(manifest, segment)
        decoded.put(segment, [np.zeros((stop - begin, 1), np.int16)])
    now_s = 0.0

    def media_at(world_s: float) -> tuple[float, float] | None:
        frame = world_s * rate * manifest.fps
        return (frame, rate) if frame < NUM_FRAMES else None

    time = DeviceTime(lambda: now_s)
    player = SoundPlayer(decoded, manifest.fps, time, media_at, manifest.camera())
    block = SAMPLE_RATE // 50
    while now_s < 2:
        player.pull(block, 0.0)
        now_s += block / SAMPLE_RATE
    expected_s = len(lacking) * manifest.segment_frames / manifest.fps / rate
    assert player.missing_s == pytest.approx(expected_s, abs=0.021)


TONE_HZ = 440.0


def tone(begin: int, stop: int) -> Stereo:
    wave = np.sin(np.arange(begin, stop) * 2 * np.pi * TONE_HZ / 48000)
    return np.repeat(wave.astype(np.float32)[:, None], 2, axis=1)


@pytest.mark.parametrize("rate", [0.1, 0.25, 0.5, 0.9, 1.0, 1.1, 1.5, 2.0])
def test_all_rates_keep_pitch_and_loudness(rate: float) -> None:
    splicer = Splicer(tone)
    whole = np.concatenate([splicer.hop(1000 + n * HOP * rate, rate) for n in range(100)])[HOP:]
    if rate == 1:
        np.testing.assert_allclose(whole, tone(1000 + HOP, 1000 + 100 * HOP), atol=1e-6)
    found = whole[:, 0].astype(np.float64)
    spectrum = np.abs(np.fft.rfft(found * np.hanning(len(found))))
    peak_hz = float(np.argmax(spectrum)) * 48000 / len(found)
    assert peak_hz == pytest.approx(TONE_HZ, abs=4)
    assert np.sqrt(np.mean(found**2)) == pytest.approx(np.sqrt(0.5), rel=0.1)
    # No clicks: the step between samples is never larger than the tone's steepest step.
    assert np.abs(np.diff(found)).max() < 2 * 2 * np.pi * TONE_HZ / 48000


def test_jumps_and_ends_fade() -> None:
    splicer = Splicer(tone)
    places: list[float | None] = [None, 0, 480, 960, 90000, 90480, None, None]
    found = np.concatenate([splicer.hop(place, 1.0) for place in places])[:, 0]
    assert np.abs(np.diff(found)).max() < 0.1
    assert not found[:HOP].any()
    assert not found[-HOP:].any()
