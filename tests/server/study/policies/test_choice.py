"""Properties of every policy, over made-up streams, links and leads."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from codec.errors import InvalidError
from server.abr.decisioncontext import DecisionContext, Policy, Send, SendSlices, SendSnapshots
from server.abr.fixedlayers import FixedLayers
from server.abr.link.link import Link, LinkStep
from server.abr.session import SessionConfig
from server.study.policies.bola import BolaConfig
from server.study.policies.choice import POLICIES
from server.study.policies.dynamic import DynamicConfig
from server.study.policies.inorder import InOrder
from server.study.policies.robustmpc import RobustMpcConfig, RobustMpcRule
from server.study.policies.situation import Rule
from server.study.policies.taildrop import TailDropConfig, TailDropRule
from server.study.policies.throughput import ThroughputRule
from server.study.simulate.simulator import play_out, simulate
from tests.server.study.policies.made_media import medias
from tests.server.study.policies.situations import situation
from tests.support.delivery.media import MadeMedia

AT_MOST_S = 300.0
IN_ORDER = sorted(set(POLICIES) - {"sweep"})
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
            self._check_snapshots(context, send)
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

    def _check_snapshots(self, context: DecisionContext, send: SendSnapshots) -> None:
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
    policy = FixedLayers(2) if name == "fixed" else POLICIES[name](media)
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
    result = simulate(media, POLICIES[name](media), link, config)
    shown, clock = play_out(media, result, config, 0, media.num_frames)
    assert clock.stalls == 0
    assert {s.layers for s in shown[-90:]} == {media.num_layers}


@pytest.mark.parametrize("name", IN_ORDER)
@given(medias())
@settings(QUICK, max_examples=10)
def test_a_link_below_layer_0_gets_layer_0(name: str, media: MadeMedia) -> None:
    least_bps = 8 * media.fps * min(s.slice_bytes[0] for s in media.segments)
    link = Link([LinkStep(1.0, 0.8 * least_bps, 0.02)])
    result = simulate(media, POLICIES[name](media), link)
    assert {a.what.end_layer for a in result.arrivals} == {1}


@pytest.mark.parametrize("rule", [RobustMpcRule(), TailDropRule(), ThroughputRule()])
def test_before_anything_is_measured_there_is_one_layer(rule: Rule) -> None:
    assert rule.choose_layers(situation(rate_bps=1e9, measured=False)) == 1


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: BolaConfig(low_lead=0.5, high_lead=0.5), "give them rising"),
        (lambda: BolaConfig(most_wait=0), "most_wait 0"),
        (lambda: DynamicConfig(to_bola=0.2, to_throughput=0.3), "to_throughput"),
        (lambda: FixedLayers(0), "layers is 0"),
        (lambda: InOrder(ThroughputRule(), 0.0), "group_s is 0"),
        (lambda: RobustMpcConfig(horizon=0), "horizon is 0"),
        (lambda: TailDropConfig(share=0), "share is 0"),
        (lambda: ThroughputRule(safety=0), "safety is 0"),
    ],
)
def test_numbers_that_make_no_policy_are_refused(make: Callable[[], object], message: str) -> None:
    with pytest.raises(InvalidError, match=message):
        make()
