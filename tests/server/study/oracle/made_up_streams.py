"""Small random streams, links, rules and policies of a play, with awkward cases."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import accumulate

import numpy as np

from server.abr.decisioncontext import DecisionContext, Policy, Send, SendSlices, SendSnapshots
from server.abr.link.link import Link, LinkStep
from server.abr.media import SegmentSizes
from server.abr.playout import PlayoutConfig
from server.abr.session import SessionConfig
from server.study.simulate.qoe import Qoe, QoeConfig, score
from server.study.simulate.simulator import play_out, simulate


@dataclass(frozen=True)
class Stream:
    """A stream with different segments."""

    fps: float
    segment_frames: int
    num_frames: int
    num_layers: int
    segments: tuple[SegmentSizes, ...]
    live: bool = False
    temporal_layer: int | None = None

    def sizes(self, birth: int) -> SegmentSizes:
        return self.segments[min(birth // self.segment_frames, len(self.segments) - 1)]

    @property
    def need_bps(self) -> float:
        """Rate of all layers."""
        return 8 * self.fps * float(np.mean([sizes.slice_bytes[-1] for sizes in self.segments]))


def make_stream(
    rng: np.random.Generator,
    seconds: float = 12.0,
    fps: float | None = None,
    num_layers: int | None = None,
    segment_frames: int | None = None,
) -> Stream:
    fps = fps or float(rng.choice([5, 10, 12]))
    num_layers = num_layers or int(rng.integers(1, 5))
    segment_frames = segment_frames or int(rng.choice([3, 7, 10, 15]))
    num_frames = max(2, int(seconds * fps))
    segments = []
    temporal = num_layers - 1 if num_layers > 1 and rng.random() < 0.3 else None
    for _ in range(-(-num_frames // segment_frames)):
        layer_bytes = rng.uniform(2e3, 2e4, num_layers)
        if rng.random() < 0.1:
            layer_bytes[int(rng.integers(num_layers))] = 0.0
        gains_db = [20 + 8 * rng.random(), *rng.uniform(0, 3, num_layers - 1).tolist()]
        snapshots = layer_bytes * rng.uniform(0.5, 12, num_layers)
        changed = rng.choice([0.0, 0.1, 0.3, 1.0], num_layers, p=[0.1, 0.4, 0.4, 0.1])
        if temporal is not None:
            changed[temporal], snapshots[temporal] = 1.0, 20.0
        segments.append(
            SegmentSizes(
                tuple(layer_bytes.tolist()),
                tuple(accumulate(gains_db)),
                tuple(snapshots.tolist()),
                tuple(changed.tolist()),
            )
        )
    return Stream(
        fps, segment_frames, num_frames, num_layers, tuple(segments), temporal_layer=temporal
    )


def make_link(rng: np.random.Generator, need_bps: float, even: bool = False) -> Link:
    """A link with outages that carries a part of the stream, or slightly more than all. even: with
    constant latency."""
    mean_bps = max(1e4, need_bps) * rng.uniform(0.3, 2.0)
    same_s = float(rng.uniform(0, 0.1)) if even or rng.random() < 0.6 else None
    steps = []
    for _ in range(int(rng.integers(1, 12))):
        rate_bps = 0.0 if rng.random() < 0.2 else mean_bps * float(rng.exponential())
        latency_s = float(rng.uniform(0, 0.4)) if same_s is None else same_s
        steps.append(LinkStep(float(rng.uniform(0.1, 4)), rate_bps, latency_s))
    steps.append(LinkStep(float(rng.uniform(0.5, 4)), mean_bps, same_s or 0.0))
    return Link(steps)


def make_rules(rng: np.random.Generator) -> tuple[SessionConfig, QoeConfig]:
    session = SessionConfig(
        max_lead_s=float(rng.choice([1.0, 2.5, 6.0])),
        first_bytes=int(rng.choice([4_000, 64_000])),
        playout=PlayoutConfig(start_lead_s=float(rng.choice([0.0, 0.1, 0.8]))),
    )
    qoe = QoeConfig(
        stall_db=float(rng.choice([5.0, 33.0])),
        switch_db=float(rng.choice([0.0, 1.0, 4.0])),
        stretch_s=float(rng.choice([0.5, 1.3])),
    )
    return session, qoe


def make_span(rng: np.random.Generator, media: Stream) -> tuple[int, int]:
    """First frame of a play, and one past its last; mostly more than a second apart."""
    if rng.random() < 0.5:
        return 0, media.num_frames
    first = int(rng.integers(0, media.num_frames // 2))
    return first, int(rng.integers(first + 1 + media.num_frames // 4, media.num_frames + 1))


def play_through(
    media: Stream,
    policy: Policy,
    link: Link,
    rules: tuple[SessionConfig, QoeConfig],
    first_frame: int,
    until_frame: int,
) -> Qoe | None:
    """The score of a play of all these frames; None if some never showed."""
    session, qoe = rules
    result = simulate(media, policy, link, session, first_frame, until_frame, at_most_s=300.0)
    shown, clock = play_out(media, result, session, first_frame, until_frame)
    if len(shown) < until_frame - first_frame:
        return None
    assert clock.started_s is not None
    psnr_db = [frame.psnr_db for frame in shown]
    return score(psnr_db, media.fps, clock.started_s, clock.stalled_s, clock.stalls, qoe)


class Whims:
    """Sends at random anything allowed, useful or not."""

    mends = True

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng
        self._base = rng.uniform(0.2, 0.9)  # how often layer 0 is sent first
        self._idle = rng.choice([0.0, 0.0, 0.2])
        self._next_birth: int | None = None

    def choose(self, context: DecisionContext) -> Send | None:
        rng = self._rng
        if rng.random() < self._idle:
            return None
        if rng.random() < self._base:
            send = self._base_layer(context)
            if send is not None:
                return send
        return self._upper_layer(context)

    def _base_layer(self, context: DecisionContext) -> Send | None:
        """Layer 0 in order, sometimes with other layers."""
        media, first = context.media, context.clock.first_frame
        end_layer = int(self._rng.integers(1, media.num_layers + 1)) if self._whim(0.4) else 1
        birth = self._next_birth
        if birth is None:
            segments = first // media.segment_frames
            segment = int(self._rng.integers(segments + 1)) if self._whim(0.2) else segments
            self._next_birth = segment * media.segment_frames + 1
            return SendSnapshots(segment * media.segment_frames, 0, end_layer)
        end = min(context.end_birth, birth + int(self._rng.integers(1, 4)))
        if birth >= end:
            return None
        if birth % media.segment_frames == 0 and self._whim(0.3):
            self._next_birth = birth + 1
            return SendSnapshots(birth, 0, end_layer)
        self._next_birth = end
        return SendSlices(range(birth, end), 0, end_layer)

    def _upper_layer(self, context: DecisionContext) -> Send | None:
        media, holding, end = context.media, context.holding, context.end_birth
        layer = int(self._rng.integers(media.num_layers))
        birth = holding.end_birth(layer)
        if birth is not None and birth < end and self._whim(0.9):
            return SendSlices(range(birth, min(end, birth + 2)), layer, layer + 1)
        starts = range(0, end, media.segment_frames)
        start = starts[max(0, len(starts) - int(self._rng.integers(1, 4)))]
        return SendSnapshots(start, layer, layer + 1) if self._whim(0.2) else None

    def _whim(self, chance: float) -> bool:
        return bool(self._rng.random() < chance)
