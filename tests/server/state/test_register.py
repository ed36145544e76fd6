"""The register of plays as a table: bounded for any messages."""

from __future__ import annotations

from server.abr.clientstatus import ClientStatus
from server.state.register import PlayRegister, StatusOutcome


def register(max_ended: int = 3, keep_s: float = 60.0) -> PlayRegister:
    return PlayRegister(max_ended, keep_s)


def ended(plays: PlayRegister, token: str, rate_bps: float | None, now_s: float) -> None:
    plays.begin(token, "walk").rate_bps = rate_bps
    plays.end(token, now_s)


def test_a_play_reads_the_newest_status_once() -> None:
    plays = register()
    entry = plays.begin("a", "walk")
    assert entry.pop_status() is None
    outcomes = [plays.report("a", "walk", ClientStatus(n)) for n in range(1000)]
    assert outcomes == [StatusOutcome.TAKEN] + 999 * [StatusOutcome.REPLACED]
    assert entry.pop_status() == ClientStatus(999)
    assert entry.pop_status() is None
    assert plays.report("a", "walk", ClientStatus(1)) is StatusOutcome.TAKEN


def test_a_status_reaches_only_a_running_play_of_its_own_stream() -> None:
    plays = register()
    entry = plays.begin("a", "walk")
    assert plays.report("a", "dance", ClientStatus(1)) is StatusOutcome.UNKNOWN
    assert plays.report("b", "walk", ClientStatus(1)) is StatusOutcome.UNKNOWN
    assert len(plays) == 1
    plays.end("a", 0.0)
    assert plays.report("a", "walk", ClientStatus(1)) is StatusOutcome.UNKNOWN
    assert entry.status is None
    assert len(plays) == 0


def test_who_comes_back_soon_is_known() -> None:
    plays = register(keep_s=60.0)
    ended(plays, "a", 5e6, now_s=100.0)
    assert plays.rate_bps("a", 160.0) == 5e6
    assert plays.rate_bps("a", 160.1) is None
    assert plays.rate_bps("b", 100.0) is None
    assert plays.rate_bps("", 100.0) is None


def test_who_seeks_is_known_while_the_old_play_still_runs() -> None:
    plays = register()
    entry = plays.begin("a", "walk")
    assert plays.rate_bps("a", 0.0) is None
    entry.rate_bps = 7e6
    assert plays.rate_bps("a", 0.0) == 7e6


def test_only_the_newest_are_remembered() -> None:
    plays = register(max_ended=3)
    for n in range(1000):
        ended(plays, str(n), 1e6 + n, now_s=0.0)
    known = [n for n in range(1000) if plays.rate_bps(str(n), 0.0) is not None]
    assert known == [997, 998, 999]
    nobody = register(max_ended=0)
    ended(nobody, "a", 1e6, now_s=0.0)
    assert nobody.rate_bps("a", 0.0) is None


def test_a_play_that_measured_nothing_takes_no_place() -> None:
    plays = register(max_ended=1)
    ended(plays, "a", 5e6, now_s=0.0)
    ended(plays, "b", None, now_s=0.0)
    assert plays.rate_bps("a", 0.0) == 5e6
