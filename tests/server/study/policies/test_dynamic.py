"""Dynamic's choice between its two rules."""

from __future__ import annotations

from server.study.policies.dynamic import DynamicRule
from server.study.policies.situation import Situation
from tests.server.study.policies.situations import situation


class Says:
    """A rule whose choice the test sets."""

    horizon = 1

    def __init__(self) -> None:
        self.layers = 1

    def choose_layers(self, situation: Situation) -> int:
        return self.layers


class Both:
    """Dynamic with two controlled rules; leads are shares of the maximum."""

    def __init__(self) -> None:
        self.rule = DynamicRule()
        self.throughput, self.bola = Says(), Says()
        self.rule._throughput = self.throughput
        self.rule._bola = self.bola

    def follows_bola(self, share: float, throughput: int = 1, bola: int = 3) -> bool:
        self.throughput.layers, self.bola.layers = throughput, bola
        chosen = self.rule.choose_layers(situation(lead_s=6.0 * share))
        assert chosen in (throughput, bola)
        return chosen == bola


def test_bola_rules_from_half_of_the_lead_on_down_to_a_quarter() -> None:
    both = Both()
    assert not both.follows_bola(0.49)
    assert both.follows_bola(0.51)
    assert both.follows_bola(0.26)
    assert both.follows_bola(0.24)  # it chooses at least as many as the other
    assert not both.follows_bola(0.24, throughput=3, bola=1)
    assert not both.follows_bola(0.49)


def test_bola_does_not_take_over_with_fewer_layers() -> None:
    both = Both()
    assert not both.follows_bola(0.9, throughput=3, bola=2)
    assert both.follows_bola(0.9, throughput=2, bola=3)
    assert both.follows_bola(0.9, throughput=3, bola=2)
