"""Layers that tail drop omits."""

from __future__ import annotations

import pytest

from codec.errors import InvalidError
from server.study.policies.taildrop import TailDropConfig, TailDropRule
from tests.server.study.policies.situations import group, situation

SLICE = group(media_s=1 / 30)
"""80, 120 and 160 kbit with 1, 2 and 3 layers: 2.4, 3.6 and 4.8 Mbit/s."""


def sent(rate_bps: float) -> list[int]:
    rule = TailDropRule(TailDropConfig(share=1.0))
    now = situation((SLICE,), rate_bps)
    return [rule.choose_layers(now) for _ in range(300)]


def test_it_sends_all_that_the_link_carries_and_at_least_layer_0() -> None:
    assert set(sent(4.9e6)) == {3}
    assert set(sent(2.3e6)) == {1}


def test_between_two_layers_there_are_no_turns() -> None:
    snapshots = (50e3, 20e3, 20e3)
    slots = group(snapshot_bytes=snapshots, media_s=1 / 30)
    middle = group(can_rise=False, media_s=1 / 30)
    rule = TailDropRule(TailDropConfig(share=1.0))
    for rate_bps, layers in ((3.5e6, 1), (3.7e6, 2), (9e6, 3)):
        for coming in (slots, middle):
            chosen = {rule.choose_layers(situation((coming,), rate_bps, held=3)) for _ in range(50)}
            assert chosen == {layers}


def test_before_anything_is_measured_there_is_one_layer() -> None:
    assert TailDropRule().choose_layers(situation(rate_bps=1e9, measured=False)) == 1


def test_its_share_is_positive() -> None:
    with pytest.raises(InvalidError, match="share is 0"):
        TailDropConfig(share=0)
