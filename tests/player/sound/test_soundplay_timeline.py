"""Pictures and sound on one time line: flashes and clicks in simulated time.

They cover a device that takes blocks at irregular moments by its own clock, a stream that arrives
in time or late, seeks, stalls, loops, rates and pauses. The true time of each shown frame and each
heard click is recorded.
"""

from __future__ import annotations

import random
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from codec.stream.manifest import Manifest
from codec.stream.sound import SAMPLE_RATE, SoundSource, first_sample
from player.playout.clock import Clock, DeviceTime
from player.playout.timeline import Playout
from player.sound.feed import DecodedSound, segment_span
from player.sound.soundplayer import SoundPlayer
from player.source.source import KeyframePackets, Packets, SlicePackets
from server.abr.playout import PlayoutConfig
from tests.support.hosted_streams import small_manifest
from tests.support.sounding import BURST

MINUTES = 5
EVERY = 23
"""Frames from one flash with its click to the next."""

PERIOD = 960
LATENCY_S = 0.04
MOST_APART_S = 0.02


def stream_of(num_frames: int) -> tuple[Manifest, DecodedSound]:
    manifest = replace(
        small_manifest(4, 0, 30.0, segment_frames=30), sound=(SoundSource("main", 1),)
    )
    decoded = DecodedSound(manifest)
    for segment in range(-(-num_frames // 30)):
        begin, stop = segment_span(manifest, segment)
        samples = np.zeros((stop - begin, 1), np.int16)
        for frame in range(segment * 30, min(segment * 30 + 30, num_frames)):
            if frame % EVERY == EVERY // 2:
                at = first_sample(frame, 30.0) - begin
                samples[at : at + len(BURST), 0] = BURST[: len(samples) - at]
        decoded.put(segment, [samples])
    return manifest, decoded


@dataclass
class World:
    """A playback in simulated time with the player's own code, without its threads."""

    num_frames: int
    drift: float
    now_s: float = 0.0
    flashes: list[tuple[float, int]] = field(default_factory=list)
    clicks: list[float] = field(default_factory=list)
    held_until_s: float = 0.0  # nothing arrives until then

    def __post_init__(self) -> None:
        self.manifest, decoded = stream_of(self.num_frames)
        self.random = random.Random(7)
        self.time = DeviceTime(lambda: self.now_s)
        self.clock = Clock(True, self.time.time_s)
        self.plays: list[Playout] = []
        self.sent: list[int] = []
        camera = self.manifest.camera()
        self.player = SoundPlayer(decoded, 30.0, self.time, self.media_at, camera)
        self.pulled = 0  # samples
        self.pull_s = 0.0
        self.loud = False
        self.begin(0)

    def begin(self, frame: int, not_before_s: float = 0.0) -> None:
        config = PlayoutConfig(conceal_s=0.15)
        self.plays.append(
            Playout(self.manifest, frame, self.num_frames, None, config, not_before_s=not_before_s)
        )
        self.sent.append(frame)

    def seek(self, frame: int) -> None:
        self.plays.clear()
        self.sent.clear()
        self.begin(frame)

    def media_at(self, world_s: float) -> tuple[float, float] | None:
        shown = self.clock.at(world_s)
        if shown is None:
            return None
        for playout in self.plays:
            frame = playout.media_frame(shown[0])
            if frame is not None:
                return frame, shown[1]
        return None

    def run(self, seconds: float, loops: bool = False) -> None:
        end_s = self.now_s + seconds
        while self.now_s < end_s:
            self.now_s += 0.002
            self.receive(loops)
            now_s = self.clock.now_s()
            for playout in self.plays[:1]:
                while self.clock.running and (due := playout.pop_due(now_s)) is not None:
                    if due.record.frame % EVERY == EVERY // 2:
                        self.flashes.append((self.now_s, due.record.frame))
            if len(self.plays) > 1 and self.plays[0].end_frame == self.num_frames:
                end = self.plays[0].end_s
                if end is not None and now_s >= end:
                    self.plays.pop(0)
                    self.sent.pop(0)
            self.listen()

    def receive(self, loops: bool) -> None:
        if self.now_s < self.held_until_s:
            return
        for number, playout in enumerate(self.plays):
            for _ in range(3):
                birth = self.sent[number]
                if birth >= self.num_frames or playout.frames_waiting > 60:
                    break
                for one in self.packets(birth, birth == playout._clock.first_frame):
                    playout.push(one, self.clock.now_s())
                self.sent[number] += 1
        if loops and len(self.plays) == 1 and self.sent[0] >= self.num_frames:
            self.begin(0, self.plays[0].end_s or 0.0)

    def packets(self, birth: int, is_first: bool) -> Iterator[Packets]:
        """What comes for `birth`; first of all the keyframe of its segment."""
        begin = birth - birth % 30 if is_first else birth
        if is_first:
            yield KeyframePackets(begin, 0, (b"x",), lambda error, part: error)
            begin += 1
        for one in range(begin, birth + 1):
            yield SlicePackets(one, 0, (b"x",), None, lambda error, part: error)

    def listen(self) -> None:
        """Takes a block for the device if it is due; its sample n is heard at (n / rate)."""
        rate = SAMPLE_RATE * (1 + self.drift)
        if self.now_s < self.pull_s:
            return
        block = self.player.pull(PERIOD, LATENCY_S)
        begin_s = self.pulled / rate + LATENCY_S
        for n in np.flatnonzero(np.abs(block[:, 0]) > 6000):
            heard_s = begin_s + n / rate
            if not self.clicks or heard_s > self.clicks[-1] + 0.1:
                self.clicks.append(heard_s)
        self.pulled += PERIOD
        # Blocks are up to 8 ms late.
        self.pull_s = self.pulled / rate + self.random.uniform(0, 0.008)

    def worst_s(self, but_after_s: list[float]) -> float:
        """Largest distance from a flash to the nearest click. but_after_s: moments after which
        earlier samples are heard for 0.1 s, which includes LATENCY_S; they do not count."""
        clicks = np.array(self.clicks)
        worst = 0.0
        for at_s, _ in self.flashes:
            if any(-0.1 < at_s - moment_s < 0.15 for moment_s in but_after_s):
                continue
            worst = max(worst, float(np.abs(clicks - at_s).min()))
        return worst


@pytest.mark.parametrize("drift", [-2e-4, 0.0, 3e-4])
def test_clicks_and_flashes_stay_together(drift: float) -> None:
    world, moments = World(MINUTES * 60 * 30, drift), [0.0]
    dice = random.Random(1)
    world.run(20)
    for number in range(20):  # seeks
        world.seek(dice.randrange(world.num_frames - 900))
        moments.append(world.now_s)
        world.run(4)
        if number % 7 == 3:  # stalls
            world.held_until_s = world.now_s + 3.5
            moments += [world.now_s + 2, world.held_until_s]
            for _ in range(80):
                world.run(0.05)
                if world.now_s >= world.held_until_s:
                    break
            world.run(4)
    for _ in range(3):  # pauses
        world.clock.stop()
        moments.append(world.now_s)
        world.run(1.3)
        world.clock.start()
        moments.append(world.now_s)
        world.run(4)
    world.run(MINUTES * 60 - 200)
    assert sum(playout.totals.stalls for playout in world.plays) <= 3
    assert len(world.flashes) > 200
    assert world.worst_s(moments) < MOST_APART_S


def test_loops_stay_together_without_a_gap() -> None:
    world = World(150, 1e-4)
    world.run(5.0 * 11, loops=True)
    assert len(world.flashes) > 60
    assert len(world.clicks) == pytest.approx(len(world.flashes), abs=2)
    assert world.worst_s([0.0]) < MOST_APART_S


@pytest.mark.parametrize("rate", [0.25, 0.5, 1.5, 2.0])
def test_rates_stay_together(rate: float) -> None:
    world = World(9000, 0.0)
    world.run(5)
    world.clock.set_rate(rate)
    moments = [0.0, world.now_s]
    world.run(40)
    assert len(world.flashes) > 10
    # At low rates a click itself is longer: 20 ms of the stream.
    assert world.worst_s(moments) < MOST_APART_S / min(rate, 1)


def test_the_time_of_a_device_passes_evenly_and_never_back() -> None:
    now_s, dice = 0.0, random.Random(3)
    time = DeviceTime(lambda: now_s)
    last_s, before_s, uneven = time.time_s(), 0.02, []
    for n in range(20000):
        world_s, now_s = now_s, n * 0.02 * 1.0003 + dice.uniform(0, 0.01)
        begin_s = time.pulled(0.02, 0.04)
        assert begin_s == pytest.approx(before_s + 0.02, abs=0.011 if n == 0 else 1e-9)
        before_s = begin_s
        shown_s = time.time_s()
        assert shown_s >= last_s
        uneven.append((shown_s - last_s) - (now_s - world_s))
        last_s = shown_s
    # The samples heard now were taken 40 ms ago, and the clock accounts for it.
    assert abs(last_s + 0.04 - begin_s) < 0.01
    # A device that stops and continues does so from the clock's time.
    now_s += 5
    shown_s = time.time_s()
    assert shown_s - last_s == pytest.approx(5, abs=1e-3)
    assert max(abs(step) for step in uneven) < 5e-4
    assert time.pulled(0.02, 0.04) == pytest.approx(shown_s + 0.04)
