"""Layers that tail drop omits."""

from __future__ import annotations

from server.study.policies.taildrop import TailDropConfig, TailDropRule
from tests.server.study.policies.situations import group, situation


def test_between_two_layers_there_are_no_turns() -> None:
    snapshots = (50e3, 20e3, 20e3)
    slots = group(snapshot_bytes=snapshots, media_s=1 / 30)
    middle = group(can_rise=False, media_s=1 / 30)
    rule = TailDropRule(TailDropConfig(share=1.0))
    for rate_bps, layers in ((2.3e6, 1), (3.5e6, 1), (3.7e6, 2), (4.9e6, 3)):
        for coming in (slots, middle):
            chosen = {rule.choose_layers(situation((coming,), rate_bps, held=3)) for _ in range(50)}
            assert chosen == {layers}
