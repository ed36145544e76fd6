"""Policies beside the bound, and the policy that only the bench has."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from bench.abr.abr import ComparisonConfig, run
from bench.abr.ahead import ahead_db, mean_interval
from bench.abr.dynamic import Dynamic
from server.study.policies import Group, Rule, Situation
from server.study.study import Play
from tests.support.slots.folder import write_slots


def test_the_table_has_every_policy_below_the_oracle(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_slots(tmp_path / "stream", 16)
    steps = [{"duration_ms": 800, "bandwidth_kbps": kbps, "latency_ms": 25} for kbps in (900, 300)]
    (tmp_path / "traces").mkdir()
    (tmp_path / "traces" / "link.json").write_text(json.dumps(steps))
    run(
        ComparisonConfig(
            tmp_path / "stream", traces=tmp_path / "traces", generate=1, loads=(0.7, 1.5),
            length_s=4, jobs=1, out=tmp_path / "out",
        )
    )  # fmt: skip
    lines = capsys.readouterr().out.splitlines()
    rows = {tuple(line.split()[:2]): line.split()[2:] for line in lines if "." in line}
    names = ("throughput", "bola", "Dynamic", "robust_mpc", "tail_drop", "sweep", "oracle")
    assert [key for key in rows if key[0] in ("0.7", "1.5", "all")] == [
        (load, name) for load in ("0.7", "1.5", "all") for name in names
    ]
    for load in ("0.7", "1.5", "all"):
        best_db, share = rows[load, "oracle"][:2]
        assert share == "1"
        assert all(float(rows[load, name][0]) <= float(best_db) for name in names)
        assert all(float(rows[load, name][1]) <= 1 for name in names)
    assert len((tmp_path / "out" / "plays.csv").read_text().splitlines()) == 1 + 2 * 2 * 6


def test_a_lead_is_the_mean_over_traces_and_where_it_would_lie_again() -> None:
    def play(trace: str, quality_db: float) -> Play:
        return Play(trace, 1.0, "p", quality_db, 0, 0, 0, 0, 0, 0, 0, 0)

    own = [play("a", 3.0), play("b", 2.0), play("a", 1.0), play("b", 2.0)]
    found = ahead_db(own, [play(one.trace, 1.0) for one in own], seed=0)
    assert (found.mean, found.low, found.high) == (1.0, 1.0, 1.0)
    found = mean_interval([0.0, 0.0, 1.0, 1.0], seed=1)
    assert found.mean == 0.5
    assert (found.low, found.high) == (0.0, 1.0)
    assert mean_interval([0.0, 0.0, 1.0, 1.0], seed=1) == found


class Says(Rule):
    """A rule whose choice the test sets."""

    layers = 1

    def choose_layers(self, situation: Situation) -> int:
        return self.layers


class Both:
    """Dynamic with two controlled rules; leads are shares of the maximum."""

    def __init__(self) -> None:
        self.rule = Dynamic()
        self.rule.throughput, self.rule.bola = self.throughput, self.bola = Says(), Says()

    def follows_bola(self, share: float, throughput: int = 1, bola: int = 3) -> bool:
        self.throughput.layers, self.bola.layers = throughput, bola
        group = Group(0.5, (1e4, 2e4, 3e4), (25.0, 26.0, 27.0), (0.0, 0.0, 0.0), can_rise=True)
        now = Situation(0.0, 1e6, True, 6.0 * share, 6.0, 1, (group,))
        chosen = self.rule.choose_layers(now)
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
