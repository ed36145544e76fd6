"""A playback with sound: real threads, and miniaudio's null device. test_soundplay_timeline.py
has its laws in simulated time."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import miniaudio
import numpy as np
import numpy.typing as npt
import pytest

from codec.framerange import FrameRange
from codec.stream.sound import SAMPLE_RATE, SoundSource
from codec.tracks.streamtracks import add_sound
from player.link.linkprocess import LinkProcess
from player.playout.clock import Clock, DeviceTime
from player.playout.conductor import Conductor
from player.playout.queues import Events
from player.playout.timeline import Playout
from player.report.journal import SoundCounts
from player.run.playback import WINDOW_PLAYOUT
from player.run.soundplay import sounding
from player.sound.soundplayer import SoundPlayer
from player.source.opener import Opener
from player.source.soundfiles import FolderSound
from player.source.source import Source
from server.abr.link import Link, LinkStep
from tests.player.playout.conducted import Played, World, playing
from tests.support.hosted_streams import served, write_stream
from tests.support.sounding import add_clicks, write_wav

FRAMES = 90
FLASHES = range(7, FRAMES, 15)
NULL: list[Any] = [miniaudio.Backend.NULL]

Block = npt.NDArray[np.int16]


def note_blocks(monkeypatch: pytest.MonkeyPatch, note: Callable[[Block], None]) -> None:
    """Calls `note` with each block that the device takes."""
    pull = SoundPlayer.pull

    def noted(player: SoundPlayer, count: int, latency_s: float) -> Block:
        block = pull(player, count, latency_s)
        note(block)
        return block

    monkeypatch.setattr(SoundPlayer, "pull", noted)


def played(stream: Path, clock: Clock, plays: float = 1) -> Played:
    found = Played(stream, clock, World())
    found.conductor = Conductor(found.open_at, found.make_events, clock, plays=plays)
    return found


def test_a_device_hears_what_is_fetched(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stream = write_stream(tmp_path / "s", FRAMES, slice_size=8)
    add_clicks(stream, FLASHES)
    heard, counts, time = threading.Event(), SoundCounts(), DeviceTime()
    note_blocks(monkeypatch, lambda block: heard.set() if np.abs(block).max() > 6000 else None)
    found = played(stream, Clock(True, time.time_s), plays=math.inf)
    with playing(found):
        camera, files = found.conductor.source.manifest.camera(), FolderSound(stream)
        with sounding(found.conductor, time, camera, lambda: files, counts, 1.0, NULL):
            found.poll_until(heard.is_set)
    assert "sound" not in {thread.name for thread in threading.enumerate()}
    assert counts.segments > 0
    assert counts.failed_segments == 0
    assert counts.received_bytes > 0


def test_without_a_device_the_pictures_go_on(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    stream = write_stream(tmp_path / "s", 10, slice_size=8)
    add_clicks(stream, (2,))

    def refuse(*arguments: object, **named: object) -> None:
        raise miniaudio.MiniaudioError("failed to start audio device", -1)

    monkeypatch.setattr(miniaudio.PlaybackDevice, "start", refuse)
    found = played(stream, Clock(True))
    with playing(found):
        manifest, files = found.conductor.source.manifest, FolderSound(stream)
        with sounding(
            found.conductor, DeviceTime(), manifest.camera(), lambda: files, SoundCounts(), 1, NULL
        ) as sound:
            assert sound is None
            assert "sound" not in {thread.name for thread in threading.enumerate()}
        found.poll_until(lambda: found.conductor.transport.at_end)
    assert "playing without sound: failed to start audio device" in caplog.text


PLAYED_S = 21
TIMES = 1.3
"""Ratio of the link's rate to the rate of layer 0 and the sound."""


def write_noisy_stream(folder: Path) -> float:
    """Writes a stream with noise; returns the rate of its layer 0 and sound, bit/s."""
    stream, frames, fps = folder / "s", 10 * (PLAYED_S + 5), 10.0
    write_stream(stream, frames, slice_size=280, fps=fps, segment_frames=10)
    samples = np.random.default_rng(1).normal(0, 3000, (frames * SAMPLE_RATE // 10, 1))
    write_wav(folder / "noise.wav", samples.astype(np.int16))
    add_sound(stream, folder / "noise.wav", SoundSource("main", 1), 48000)
    names = ("0", "skipmaps", "audio-main")
    needed = [path for name in names for path in (stream / "segments").glob(f"*/{name}")]
    return 8 * sum(path.stat().st_size for path in needed) * fps / frames


@pytest.mark.realtime
def test_such_a_link_carries_the_sound_without_a_gap(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The law is in test_soundfeed.py: the pace leaves the link to the pictures."""
    need_bps = write_noisy_stream(tmp_path)
    time, counts, playouts = DeviceTime(), SoundCounts(), list[Playout]()
    clock, heard_s, silent_s = Clock(True, time.time_s), 0.0, 0.0

    def note(block: Block) -> None:
        nonlocal heard_s, silent_s
        is_silent = ~np.abs(block).max(axis=1).reshape(-1, 10).any(axis=1)
        if heard_s or not is_silent.all():
            heard_s += len(block) / SAMPLE_RATE
            silent_s += float(is_silent.mean()) * len(block) / SAMPLE_RATE

    note_blocks(monkeypatch, note)

    def make_events(source: Source, play: int, not_before_s: float) -> Events:
        end = source.frames.end
        playouts.append(Playout(source.manifest, 0, end, None, WINDOW_PLAYOUT, play=play))
        return Events(playouts[-1], clock)

    found = Played(tmp_path / "s", clock, World())
    link = Link([LinkStep(1e6, TIMES * need_bps, 0.02)])
    with served(tmp_path) as server:
        address = urlsplit(server.url)
        with (
            LinkProcess(link, address.hostname or "", address.port or 0) as relay,
            closing(Opener(f"{server.url}/v1/streams/s", relay.address)) as opener,
        ):
            found.conductor = Conductor(
                lambda frame: opener.open(FrameRange(frame), None, adaptive=True),
                make_events,
                clock,
                interrupt=opener.interrupt,
            )
            with playing(found):
                camera, files = found.conductor.source.manifest.camera(), opener.sound_files
                with sounding(found.conductor, time, camera, files, counts, 1.0, NULL):
                    found.poll_until(lambda: len(found.records) >= 10 * PLAYED_S)
            assert relay.down_bytes < 1.3 * TIMES * need_bps / 8 * PLAYED_S
    totals = playouts[0].totals
    assert totals.mean_layers < 2, "the link carries more than layer 0"
    assert heard_s > PLAYED_S - 2
    # Without a pace the sound of ten seconds stalls the pictures, and itself, for over a second.
    assert totals.stalled_s + silent_s < 0.8
    assert counts.failed_segments == 0
