"""A playback with sound in real time: a real folder, real threads, and miniaudio's null device."""

from __future__ import annotations

import math
import threading
import time
from pathlib import Path
from typing import Any

import miniaudio
import numpy as np
import numpy.typing as npt
import pytest

from codec.framerange import FrameRange
from codec.stream.sound import SAMPLE_RATE
from player.playout.clock import Clock
from player.playout.conductor import Conductor
from player.playout.mediatime import DeviceTime
from player.playout.queues import Events
from player.playout.timeline import Playout
from player.render.cpu import CpuRenderer
from player.report.soundcounts import SoundCounts
from player.run.soundplay import sounding
from player.sound.soundplayer import SoundPlayer
from player.source.directory import DirectorySource
from player.source.soundfiles import FolderSound
from player.source.source import Source
from tests.support.hosted_streams import write_stream
from tests.support.sounding import add_clicks

FRAMES = 90
FLASHES = range(7, FRAMES, 15)


class NotedTime(DeviceTime):
    """Records when the first sample of the newest block is heard."""

    begin_s = 0.0

    def pulled(self, duration_s: float, latency_s: float) -> float:
        self.begin_s = super().pulled(duration_s, latency_s)
        return self.begin_s


class Clicks:
    """Records the time of each click on the playback's clock."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, time: NotedTime, clock: Clock) -> None:
        self.heard_s: list[float] = []
        pull = SoundPlayer.pull

        def noted(player: SoundPlayer, count: int, latency_s: float) -> npt.NDArray[np.int16]:
            block = pull(player, count, latency_s)
            for n in np.flatnonzero(np.abs(block[:, 0]) > 6000):
                shown = clock.at(time.begin_s + n / SAMPLE_RATE)
                assert shown is not None
                if not self.heard_s or shown[0] > self.heard_s[-1] + 0.1:
                    self.heard_s.append(shown[0])
            return block

        monkeypatch.setattr(SoundPlayer, "pull", noted)


def test_clicks_and_flashes_in_real_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stream = write_stream(tmp_path / "s", FRAMES, slice_size=8)
    add_clicks(stream, FLASHES)
    device_time = NotedTime()
    clock = Clock(True, device_time.time_s)
    clicks = Clicks(monkeypatch, device_time, clock)

    def open_at(frame: int) -> Source:
        return DirectorySource(stream, FrameRange(frame), None)

    def make_events(source: Source, play: int, not_before_s: float) -> Events:
        frames = source.frames
        playout = Playout(
            source.manifest, frames.first, frames.end, not_before_s=not_before_s, play=play
        )
        return Events(playout, clock)

    flashes_s: list[float] = []
    unfair_s, counts = [0.0], SoundCounts()
    with Conductor(open_at, make_events, clock, plays=math.inf) as conductor:
        renderer = CpuRenderer(conductor.source.manifest)
        conductor.attach(renderer)
        camera = conductor.source.manifest.camera()
        backends: list[Any] = [miniaudio.Backend.NULL]
        files = FolderSound(stream)
        with sounding(conductor, device_time, camera, lambda: files, counts, 1.0, backends):
            seeks = 0
            while len(flashes_s) < 24:
                for record in conductor.poll():
                    if record.frame in FLASHES:
                        # Times of the time line, because a busy machine draws late.
                        flashes_s.append(record.shown_s)
                if len(flashes_s) > 8 + 3 * seeks and seeks < 4:
                    conductor.seek((17 * seeks + 31) % FRAMES)
                    unfair_s.append(clock.now_s())
                    seeks += 1
                time.sleep(0.005)
    assert "sound" not in {thread.name for thread in threading.enumerate()}
    heard_s = np.array(clicks.heard_s)
    apart_s = [
        float(np.abs(heard_s - at_s).min())
        for at_s in flashes_s
        if not any(-0.1 < at_s - moment_s < 0.4 for moment_s in unfair_s)
    ]
    assert len(apart_s) > 8
    # A long delay of the device's thread loses samples, audibly.
    assert float(np.median(apart_s)) < 0.005
    assert sorted(apart_s)[-4] < 0.02
    assert counts.failed_segments == 0
    assert counts.segments >= FRAMES // 5


@pytest.mark.parametrize("part", ["__init__", "start"])
def test_without_a_device_the_pictures_go_on(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch, part: str
) -> None:
    stream = write_stream(tmp_path / "s", 10, slice_size=8)
    add_clicks(stream, (2,))

    def refuse(*arguments: object, **named: object) -> None:
        raise miniaudio.MiniaudioError("failed to start audio device", -1)

    if part == "__init__":
        monkeypatch.setattr(miniaudio.PlaybackDevice, "close", lambda device: None)
    monkeypatch.setattr(miniaudio.PlaybackDevice, part, refuse)
    backends: list[Any] = [miniaudio.Backend.NULL]
    clock = Clock(True)
    source = DirectorySource(stream, FrameRange(), None)

    def make_events(source: Source, play: int, not_before_s: float) -> Events:
        return Events(Playout(source.manifest, 0, source.frames.end), clock)

    with Conductor(lambda _: source, make_events, clock) as conductor:
        conductor.attach(CpuRenderer(source.manifest))
        files, camera = FolderSound(stream), source.manifest.camera()
        with sounding(
            conductor, DeviceTime(), camera, lambda: files, SoundCounts(), 1.0, backends
        ) as sound:
            assert sound is None
            assert "sound" not in {thread.name for thread in threading.enumerate()}
    assert "playing without sound: failed to start audio device" in caplog.text
