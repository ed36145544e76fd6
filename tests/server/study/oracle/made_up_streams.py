"""Small random streams, links and rules of a play, with awkward cases."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import accumulate

import numpy as np

from server.abr.decisioncontext import Policy
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
