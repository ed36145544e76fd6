"""Case after case: the plays are those of the simulator, and the record of a play matches it."""

from __future__ import annotations

from itertools import pairwise
from statistics import fmean

import pytest

from codec.errors import InvalidError
from server.abr.link.link import Link, LinkStep
from server.study.cases import Case, at_load
from server.study.looped import LoopedMedia
from server.study.plays import Rules, judge, run_case, run_play
from server.study.policies.choice import POLICIES
from server.study.report.timecourse import follow
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


def test_normalised_qoe_of_a_play_is_between_layer_0_and_the_bound() -> None:
    case = case_of(1.0)
    oracle = judge(MEDIA, case, RULES)
    (play,) = run_case(MEDIA, case, ["sweep"], RULES).plays
    room_db = oracle.quality_db - oracle.base_db
    expected = (play.quality_db - oracle.base_db) / room_db
    assert play.normalised == pytest.approx(expected, abs=1e-4)


def test_notes_fit_the_play() -> None:
    case = case_of(0.25)
    line = follow(MEDIA, case, "sweep", RULES)
    _, shown, clock = run_play(MEDIA, case, "sweep", RULES)
    assert clock.started_s is not None
    assert clock.stalls
    begin, *stalls = line.stalls_s
    assert begin == (0.0, clock.started_s)
    assert len(stalls) == clock.stalls
    assert sum(until_s - since_s for since_s, until_s in stalls) == pytest.approx(clock.stalled_s)
    assert fmean(layers for _, layers in line.layers) == fmean(one.layers for one in shown)
    assert len(line.lead_s) == MEDIA.num_frames
    # A shown frame has arrived, and the lead does not exceed its limit.
    frame_s = 1 / MEDIA.fps
    most_s = RULES.session.max_lead_s + frame_s
    assert all(frame_s - 1e-9 <= lead_s <= most_s for _, lead_s in line.lead_s)
    for (time_s, rate_bps), (next_s, _) in pairwise(line.link_bps):
        assert case.link.at((time_s + next_s) / 2).rate_bps == rate_bps
    assert all(earlier < later for (earlier, _), (later, _) in pairwise(line.estimate_bps))


def test_a_play_that_does_not_end_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("server.study.plays.MOST_S", 4.0)
    with pytest.raises(InvalidError, match=r"trace uneven at load 0\.5: bola has shown"):
        run_play(MEDIA, case_of(0.5), "bola", RULES)
