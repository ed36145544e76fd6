"""Case after case: the plays are those of the simulator, and the record of a play matches it."""

from __future__ import annotations

import pytest

from codec.errors import InvalidError
from server.abr.link.link import Link, LinkStep
from server.study.cases import Case, at_load
from server.study.looped import LoopedMedia
from server.study.plays import Rules, run_case, run_play
from server.study.policies.choice import POLICIES
from server.study.tracefolder import Trace
from tests.support.delivery.media import basketball_media

MEDIA = LoopedMedia((basketball_media().sizes(0),), 240, 30.0, 30)
TRACE = Trace(
    "uneven", Link([LinkStep(2, 8e6, 0.02), LinkStep(1.5, 0.2e6, 0.04), LinkStep(3, 5e6, 0.02)])
)
RULES = Rules()


def case_of(load: float) -> Case:
    return at_load(TRACE, load, MEDIA)


@pytest.mark.parametrize("load", [0.5, 1.2])
def test_every_policy_plays_and_none_beats_the_oracle(load: float) -> None:
    outcome = run_case(MEDIA, case_of(load), list(POLICIES), RULES)
    assert [play.policy for play in outcome.plays] == list(POLICIES)
    oracle = outcome.oracle
    assert oracle.base_db <= oracle.quality_db
    for play in outcome.plays:
        assert play.quality_db <= oracle.quality_db + 1e-3
        assert play.normalised <= 1.001
        assert 1 <= play.layers <= 4
        assert play.low_psnr_db <= play.psnr_db
        waited_s = play.startup_s + play.rebuffering * MEDIA.length_s
        assert waited_s >= oracle.startup_s + oracle.rebuffering * MEDIA.length_s - 1e-3


def test_a_play_that_does_not_end_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("server.study.plays.MOST_S", 4.0)
    with pytest.raises(InvalidError, match=r"trace uneven at load 0\.5: bola has shown"):
        run_play(MEDIA, case_of(0.5), "bola", RULES)
