"""Slices sent in order of birth, and the situations given to rules."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from server.abr.decisioncontext import SendSlices, SendSnapshots
from server.abr.link.link import Link, LinkStep
from server.study.policies.inorder import InOrder, group_end
from server.study.policies.situation import Situation
from server.study.simulate.simulator import simulate
from tests.server.study.policies.made_media import medias
from tests.support.delivery.media import MadeMedia, sizes_of

FAST = Link([LinkStep(1.0, 50e6, 0.02)])
MEDIA = MadeMedia((sizes_of((8e3, 2e3, 3e3), (25.0, 1.0, 1.0), (60e3, 20e3, 30e3)),))


@dataclass
class Whims:
    """Chooses the test's layers, group by group, cyclically."""

    layers: list[int]
    horizon: int = 3
    asked: list[Situation] = field(default_factory=list)

    def choose_layers(self, situation: Situation) -> int:
        self.asked.append(situation)
        return self.layers[(len(self.asked) - 1) % len(self.layers)]


@given(medias(), st.floats(0.02, 2.0), st.integers(-30, 200))
def test_groups_follow_each_other_and_begin_with_segments(
    media: MadeMedia, group_s: float, birth: int
) -> None:
    end = group_end(media, birth, group_s)
    assert birth < end
    assert all(group_end(media, b, group_s) == end for b in range(birth, end))
    # No group extends beyond a segment that it does not contain completely.
    frames = media.segment_frames
    assert end - birth <= frames - birth % frames or end % frames == 0


@given(
    medias(),
    st.lists(st.integers(1, 4), min_size=1, max_size=7),
    st.integers(0, 19),
    st.floats(0.03, 0.8),
)
@settings(max_examples=60, deadline=None)
def test_a_rule_is_asked_group_by_group_and_gets_its_will(
    media: MadeMedia, whims: list[int], first_frame: int, group_s: float
) -> None:
    rule = Whims(whims)
    result = simulate(media, InOrder(rule, group_s), FAST, first_frame=first_frame)
    sent: dict[int, int] = {}
    for arrival in result.arrivals:
        if isinstance(arrival.what, SendSlices):
            sent |= dict.fromkeys(arrival.what.births, arrival.what.end_layer)
    start = first_frame - first_frame % media.segment_frames + 1
    assert list(sent) == list(range(start, media.num_frames))
    assert rule.asked[0].held == 0
    for n, situation in enumerate(rule.asked):
        wanted = min(whims[n % len(whims)], situation.most_layers)
        if n + 1 < len(rule.asked):
            assert rule.asked[n + 1].held == wanted
        assert situation.lead_s <= situation.max_lead_s + 1e-6
        assert 1 <= len(situation.coming) <= rule.horizon


def test_a_layer_rises_by_its_snapshot_at_a_segment_and_falls_anywhere() -> None:
    # Groups of 15 frames: segments begin at 0, 30, 60.
    media = MadeMedia(MEDIA.segments, num_frames=90, segment_frames=30)
    result = simulate(media, InOrder(Whims([1, 3, 2, 1, 3, 2])), FAST)
    sent = [a.what for a in result.arrivals]
    snapshots = [(n, s) for n, s in enumerate(sent) if isinstance(s, SendSnapshots)]
    assert [s for _, s in snapshots] == [
        SendSnapshots(0, 0, 1),
        SendSnapshots(30, 1, 2),  # three were wanted at 15, but a rise is not possible there
        SendSnapshots(60, 1, 3),
    ]
    layers = {b: s.end_layer for s in sent if isinstance(s, SendSlices) for b in s.births}
    runs = [(b, layers[b]) for b in layers if layers[b] != layers.get(b - 1)]
    assert runs == [(1, 1), (31, 2), (45, 1), (61, 3), (75, 2)]
    # The slice of the frame is sent before the snapshots.
    for n, snapshot in snapshots[1:]:
        assert sent[n - 1] == SendSlices(range(snapshot.frame, snapshot.frame + 1), 0, 1)


def test_a_rule_sees_what_comes() -> None:
    rule = Whims([2])
    media = MadeMedia(MEDIA.segments, num_frames=60, segment_frames=30)
    simulate(media, InOrder(rule), FAST, first_frame=20)
    first, second = rule.asked[0], rule.asked[1]
    # The first group only covers the way to frame 20.
    assert [g.media_s * 30 for g in first.coming] == pytest.approx([0, 10, 15])
    assert [g.can_rise for g in first.coming] == [True, False, True]
    assert first.group.snapshot_bytes == (60e3, 80e3, 110e3)
    assert first.group.slice_bytes == pytest.approx((120e3, 150e3, 195e3))
    assert first.group.psnr_db == pytest.approx((25, 26, 27))
    assert first.group.cost_bytes(2, 0) == pytest.approx(230e3)
    assert second.group.cost_bytes(2, 2) == pytest.approx(150e3)
    assert second.held == 2
    assert len(rule.asked[-1].coming) == 1


def test_what_is_sent_at_once_fits_a_run_of_the_link() -> None:
    media = MadeMedia((sizes_of((1e3, 1e3), (25.0, 1.0)),), num_frames=600)
    result = simulate(media, InOrder(Whims([2])), Link([LinkStep(1.0, 8e6, 0.01)]))
    births = [len(a.what.births) for a in result.arrivals if isinstance(a.what, SendSlices)]
    assert 1 < max(births) <= 0.02 * 8e6 / 8 / 2e3 * 1.2


def test_a_live_stream_has_as_much_lead_as_there_is() -> None:
    media = MadeMedia((sizes_of((1e3, 1e3), (25.0, 1.0)),), num_frames=45, live=True)
    rule = Whims([1])
    simulate(media, InOrder(rule), FAST, at_most_s=5.0)
    assert {round(s.max_lead_s, 3) for s in rule.asked[:2]} == {1.5}


def test_segments_are_cut_into_groups_of_about_the_same_length() -> None:
    media = MadeMedia(MEDIA.segments, num_frames=80, segment_frames=40)
    ends = [0]
    while ends[-1] < 80:
        ends.append(group_end(media, ends[-1], 0.5))
    assert [b - a for a, b in pairwise(ends)] == [14, 14, 12, 14, 14, 12]
