"""The samples that the sound device gets, and the count of those that were late."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from codec.stream.sound import SAMPLE_RATE, SoundSource
from player.playout.mediatime import DeviceTime
from player.sound.decodedsound import DecodedSound
from player.sound.segmentsound import segment_span
from player.sound.soundplayer import SoundPlayer
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
