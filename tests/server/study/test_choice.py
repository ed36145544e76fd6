"""Properties of every policy, and of slices sent in order of birth, over made-up streams."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from codec.errors import InvalidError
from server.abr.decisioncontext import (
    DecisionContext,
    FixedLayers,
    Policy,
    Send,
    SendKeyframes,
    SendSlices,
)
from server.abr.link import Link, LinkStep
from server.abr.media import SegmentSizes
from server.abr.session import SessionConfig
from server.study.choice import OWN, POLICIES, check_policy, make_policy
from server.study.policies import InOrder, Rule, Situation, group_end
from server.study.simulator import play_out, simulate
from tests.support.delivery.media import MadeMedia, sizes_of


@st.composite
def segment_sizes(draw: st.DrawFn, num_layers: int) -> SegmentSizes:
    """An upper layer takes at least a third of the first one, and adds 0.3 to 3 dB, so that sending
    a layer that the link cannot carry is never worth a stall."""
    base = draw(st.floats(2e3, 2e4))
    layers = (base, *(base * draw(st.floats(0.35, 1.5)) for _ in range(num_layers - 1)))
    gains = (25.0, *(draw(st.floats(0.3, 3.0)) for _ in range(num_layers - 1)))
    keyframes = tuple(size * draw(st.floats(2.0, 8.0)) for size in layers)
    return sizes_of(layers, gains, keyframes)


@st.composite
def medias(draw: st.DrawFn, fewest_frames: int = 20, most_frames: int = 150) -> MadeMedia:
    """Streams of one or two kinds of segments."""
    num_layers = draw(st.integers(1, 4))
    count = draw(st.integers(1, 2))
    return MadeMedia(
        tuple(draw(segment_sizes(num_layers)) for _ in range(count)),
        draw(st.integers(fewest_frames, most_frames)),
        draw(st.sampled_from((25.0, 30.0))),
        draw(st.sampled_from((4, 15, 30, 40))),
    )


AT_MOST_S = 300.0
IN_ORDER = sorted(set(POLICIES) - {OWN})
QUICK = settings(
    max_examples=25, deadline=None, phases=(Phase.explicit, Phase.reuse, Phase.generate)
)
"""Failing plays are not shrunk, because that takes minutes."""
steps = st.builds(LinkStep, st.floats(0.1, 5), st.floats(2e5, 4e7), st.floats(0, 0.1))


class Checked:
    """A policy whose decisions are checked against the client's buffer at their arrival."""

    def __init__(self, policy: Policy) -> None:
        self.policy = policy
        self.mends = policy.mends

    def choose(self, context: DecisionContext) -> Send | None:
        send = self.policy.choose(context)
        if isinstance(send, SendSlices):
            self._check_slices(context, send)
        elif send is not None:
            self._check_keyframes(context, send)
        return send

    def _check_slices(self, context: DecisionContext, send: SendSlices) -> None:
        births, holding = send.births, context.holding
        assert len(births) >= 1
        assert births.step == 1
        assert births.stop <= context.end_birth
        assert 0 <= send.first_layer < send.end_layer <= context.media.num_layers
        # A change is useful only after the previous one.
        for layer in range(send.first_layer, send.end_layer):
            assert holding.end_birth(layer) == births.start

    def _check_keyframes(self, context: DecisionContext, send: SendKeyframes) -> None:
        holding, frame = context.holding, send.frame
        assert 0 <= frame < context.end_birth
        assert frame % context.media.segment_frames == 0
        assert 0 <= send.first_layer < send.end_layer <= context.media.num_layers
        for layer in range(send.first_layer, send.end_layer):
            assert (holding.end_birth(layer) or 0) <= frame


@pytest.mark.parametrize("name", [*POLICIES, "fixed"])
@given(
    medias(),
    st.lists(steps, min_size=1, max_size=4),
    st.sampled_from((0.1, 1.0, 6.0)),
    st.integers(0, 19),
)
@QUICK
def test_it_sends_what_is_of_use_and_ends_every_play(
    name: str, media: MadeMedia, steps: list[LinkStep], max_lead_s: float, first_frame: int
) -> None:
    policy = FixedLayers(2) if name == "fixed" else make_policy(name)
    config = SessionConfig(max_lead_s=max_lead_s)
    result = simulate(media, Checked(policy), Link(steps), config, first_frame, at_most_s=AT_MOST_S)
    assert result.ended_s < AT_MOST_S
    shown, _ = play_out(media, result, config, first_frame, media.num_frames)
    assert [s.frame for s in shown] == list(range(first_frame, media.num_frames))


@pytest.mark.parametrize("name", POLICIES)
@given(medias(fewest_frames=450, most_frames=450))
@settings(QUICK, max_examples=6)
def test_a_link_for_all_layers_ends_up_with_all_layers(name: str, media: MadeMedia) -> None:
    if name == "robust_mpc":  # it prefers constant quality to a better layer
        media = replace(media, segments=media.segments[:1])
    link = Link([LinkStep(1.0, 3 * media.most_bps(media.num_layers), 0.02)])
    config = SessionConfig()
    result = simulate(media, make_policy(name), link, config)
    shown, clock = play_out(media, result, config, 0, media.num_frames)
    assert clock.stalls == 0
    assert {s.layers for s in shown[-90:]} == {media.num_layers}


@pytest.mark.parametrize("name", POLICIES)
def test_a_live_stream_is_sent_up_to_its_edge(name: str) -> None:
    media = MadeMedia(MEDIA.segments, num_frames=90, live=True)
    result = simulate(media, make_policy(name), FAST, first_frame=20, at_most_s=20.0)
    shown, _ = play_out(media, result, SessionConfig(), 20, 90)
    assert [one.frame for one in shown] == list(range(20, 90))


@pytest.mark.parametrize("name", IN_ORDER)
@given(medias())
@settings(QUICK, max_examples=10)
def test_a_link_below_layer_0_gets_layer_0(name: str, media: MadeMedia) -> None:
    least_bps = 8 * media.fps * min(s.slice_bytes[0] for s in media.segments)
    link = Link([LinkStep(1.0, 0.8 * least_bps, 0.02)])
    result = simulate(media, make_policy(name), link)
    assert {a.what.end_layer for a in result.arrivals} == {1}


FILE = """
from dataclasses import dataclass
from server.study.policies import Rule

@dataclass
class Two(Rule):
    layers: "int" = 2

    def choose_layers(self, situation):
        return self.layers

class Unfinished(Rule):
    pass

class Bare:
    pass

none = object()
"""


def test_a_policy_of_ones_own_is_named_by_its_file(tmp_path: Path) -> None:
    file = tmp_path / "own.py"
    file.write_text(FILE)
    policy = make_policy(check_policy(f"{file}:Two"))
    assert isinstance(policy, InOrder)
    assert policy is not make_policy(f"{file}:Two")
    result = simulate(MEDIA, policy, FAST)
    assert {arrival.what.end_layer for arrival in result.arrivals} == {2}


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("sweeep", "'sweeep' is unknown; choose from throughput, bola, robust_mpc, tail_drop, sw"),
        ("own.py", "or give FILE.py:NAME"),
        ("own.py:Three", "own.py:Three: the file has no 'Three'"),
        ("own.py:Unfinished", "TypeError: .* abstract"),
        ("own.py:Bare", "neither a Rule nor a Policy"),
        ("own.py:none", "TypeError: .* not callable"),
        ("broken.py:Two", "SyntaxError: .*line 1"),
        ("absent.py:Two", "absent.py: No such file"),
    ],
)
def test_what_is_no_policy_is_said_in_one_line(
    name: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("own.py").write_text(FILE)
    Path("broken.py").write_text("class Two(:")
    with pytest.raises(InvalidError, match=message) as raised:
        check_policy(name)
    assert "\n" not in str(raised.value)


FAST = Link([LinkStep(1.0, 50e6, 0.02)])
MEDIA = MadeMedia((sizes_of((8e3, 2e3, 3e3), (25.0, 1.0, 1.0), (60e3, 20e3, 30e3)),))


class Whims(Rule):
    """Chooses the test's layers, group by group, cyclically."""

    horizon = 3

    def __init__(self, layers: list[int], group_s: float = 0.5) -> None:
        self.layers = layers
        self.group_s = group_s
        self.asked: list[Situation] = []

    def choose_layers(self, situation: Situation) -> int:
        self.asked.append(situation)
        return self.layers[(len(self.asked) - 1) % len(self.layers)]


@given(medias(), st.floats(0.0, 2.0), st.integers(-30, 200))
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
    rule = Whims(whims, group_s)
    result = simulate(media, InOrder(rule), FAST, first_frame=first_frame)
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


def test_a_layer_rises_by_its_keyframe_at_a_segment_and_falls_anywhere() -> None:
    # Groups of 15 frames: segments begin at 0, 30, 60.
    media = MadeMedia(MEDIA.segments, num_frames=90, segment_frames=30)
    result = simulate(media, InOrder(Whims([1, 3, 2, 1, 3, 2])), FAST)
    sent = [a.what for a in result.arrivals]
    keyframes = [(n, s) for n, s in enumerate(sent) if isinstance(s, SendKeyframes)]
    assert [s for _, s in keyframes] == [
        SendKeyframes(0, 0, 1),
        SendKeyframes(30, 1, 2),  # three were wanted at 15, but a rise is not possible there
        SendKeyframes(60, 1, 3),
    ]
    layers = {b: s.end_layer for s in sent if isinstance(s, SendSlices) for b in s.births}
    runs = [(b, layers[b]) for b in layers if layers[b] != layers.get(b - 1)]
    assert runs == [(1, 1), (31, 2), (45, 1), (61, 3), (75, 2)]
    # The slice of the frame is sent before the keyframes.
    for n, keyframe in keyframes[1:]:
        assert sent[n - 1] == SendSlices(range(keyframe.frame, keyframe.frame + 1), 0, 1)


def test_a_rule_sees_what_comes() -> None:
    rule = Whims([2])
    media = MadeMedia(MEDIA.segments, num_frames=60, segment_frames=30)
    simulate(media, InOrder(rule), FAST, first_frame=20)
    first, second = rule.asked[0], rule.asked[1]
    # The first group only covers the way to frame 20.
    assert [g.media_s * 30 for g in first.coming] == pytest.approx([0, 10, 15])
    assert [g.can_rise for g in first.coming] == [True, False, True]
    assert first.group.keyframe_bytes == (60e3, 80e3, 110e3)
    assert first.group.slice_bytes == pytest.approx((120e3, 150e3, 195e3))
    assert first.group.psnr_db == pytest.approx((25, 26, 27))
    assert first.group.cost_bytes(2, 0) == pytest.approx(230e3)
    assert second.group.cost_bytes(2, 2) == pytest.approx(150e3)
    assert second.held == 2
    assert len(rule.asked[-1].coming) == 1
