"""Sound over a link that carries only layer 0 and the sound."""

from __future__ import annotations

import time
import wave
from contextlib import ExitStack
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import miniaudio
import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from codec.framerange import FrameRange
from codec.stream.sound import SAMPLE_RATE, SoundSource
from codec.tools.streamsound import add_sound
from player.link.linkprocess import LinkProcess
from player.playout.clock import Clock
from player.playout.conductor import Conductor
from player.playout.mediatime import DeviceTime
from player.playout.queues import Events
from player.playout.timeline import Playout
from player.render.cpu import CpuRenderer
from player.report.soundcounts import SoundCounts
from player.run.playback import WINDOW_PLAYOUT
from player.run.soundplay import sounding
from player.sound.soundfeed import GROWTH_SHARE, REST_SHARE, URGENT_S, FetchPace
from player.sound.soundplayer import SoundPlayer
from player.source.opener import Opener
from player.source.source import Source
from server.abr.link.link import Link, LinkStep
from tests.support.hosted_streams import served, write_stream

PLAYED_S = 21
TIMES = 1.3
"""Ratio of the link's rate to the rate of layer 0 and the sound."""


@given(st.floats(0.001, 2), st.floats(0.5, 10), st.floats(0.02, 0.3))
def test_sound_is_in_time_and_leaves_the_link_to_the_pictures(
    length_s: float, ahead_s: float, share: float
) -> None:
    """Each segment of `length_s` takes `share` of it to fetch. Only the first ones are late, and
    segments that are not heard soon take a small part of the time."""
    pace, took_s = FetchPace(), share * length_s
    now_s, fetched, begin_s = 0.0, 0, took_s
    while now_s < 60 * length_s:
        played_s = max(0.0, now_s - begin_s)
        due_s = max(0.0, fetched * length_s - played_s)
        if due_s < max(ahead_s, length_s) and pace.allows(due_s, now_s):
            now_s += took_s
            pace.fetched(now_s - took_s, now_s, length_s)
            assert now_s - begin_s <= fetched * length_s + 1e-9
            fetched += 1
            soon_s = URGENT_S + 3 * took_s + length_s
            most = max(1 / (1 + REST_SHARE), share / GROWTH_SHARE)
            assert took_s * fetched <= share * (played_s + soon_s) + most * now_s
        else:
            now_s += 0.01 * length_s


class Silence:
    """Duration of silence after the first sample, of a source that is never silent."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.heard_s, self.silent_s = 0.0, 0.0
        pull = SoundPlayer.pull

        def noted(player: SoundPlayer, count: int, latency_s: float) -> npt.NDArray[np.int16]:
            block = pull(player, count, latency_s)
            is_silent = ~np.abs(block).max(axis=1).reshape(-1, 10).any(axis=1)
            if self.heard_s or not is_silent.all():
                self.heard_s += count / SAMPLE_RATE
                self.silent_s += float(is_silent.mean()) * count / SAMPLE_RATE
            return block

        monkeypatch.setattr(SoundPlayer, "pull", noted)


def write_noisy_stream(folder: Path) -> tuple[Path, float]:
    """Writes a stream with noise; returns it, and the rate of its layer 0 and sound, bit/s."""
    stream, frames, fps = folder / "s", 10 * (PLAYED_S + 5), 10.0
    write_stream(stream, frames, slice_size=280, fps=fps, segment_frames=10)
    samples = np.random.default_rng(1).normal(0, 3000, (frames * SAMPLE_RATE // 10, 1))
    with wave.open(str(folder / "noise.wav"), "wb") as file:
        file.setnchannels(1)
        file.setsampwidth(2)
        file.setframerate(SAMPLE_RATE)
        file.writeframes(samples.astype("<i2").tobytes())
    add_sound(stream, folder / "noise.wav", SoundSource("main", 1), 48000)
    files = (path for path in (stream / "segments").glob("*/*"))
    needed = sum(path.stat().st_size for path in files if path.name in ("0", "masks", "audio-main"))
    return stream, 8 * needed * fps / frames


def test_such_a_link_carries_the_sound_without_a_gap(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stream, need_bps = write_noisy_stream(tmp_path)
    link = Link([LinkStep(1e6, TIMES * need_bps, 0.02)])
    silence, time_line = Silence(monkeypatch), DeviceTime()
    clock, plays, counts = Clock(True, time_line.time_s), list[Playout](), SoundCounts()
    with ExitStack() as stack:
        server = stack.enter_context(served(tmp_path))
        address = urlsplit(server.url)
        assert address.hostname is not None
        assert address.port is not None
        relay = stack.enter_context(LinkProcess(link, address.hostname, address.port))
        opener = Opener(f"{server.url}/v1/streams/{stream.name}", relay.address)
        stack.callback(opener.close)

        def open_at(frame: int) -> Source:
            return opener.open(FrameRange(frame), None, adaptive=True)

        def make_events(source: Source, play: int, not_before_s: float) -> Events:
            end = source.frames.end
            plays.append(Playout(source.manifest, 0, end, None, WINDOW_PLAYOUT, play=play))
            return Events(plays[-1], clock)

        conductor = stack.enter_context(
            Conductor(open_at, make_events, clock, interrupt=opener.interrupt)
        )
        conductor.attach(CpuRenderer(conductor.source.manifest))
        camera = conductor.source.manifest.camera()
        backends: list[Any] = [miniaudio.Backend.NULL]
        files = opener.sound_files
        with sounding(conductor, time_line, camera, files, counts, 1.0, backends):
            frames = 0
            while frames < 10 * PLAYED_S:
                frames += len(conductor.poll())
                time.sleep(0.01)
        assert relay.down_bytes < 1.3 * TIMES * need_bps / 8 * PLAYED_S
    totals = plays[0].totals
    assert totals.mean_layers < 2, "the link carries more than layer 0"
    assert silence.heard_s > PLAYED_S - 2
    # Without a pace the sound of ten seconds stalls the pictures, and itself, for over a second.
    assert totals.stalled_s + silence.silent_s < 0.8, "but for what a busy machine holds up"
    assert counts.failed_segments == 0
