"""Objects in memory, and the register of plays: bounded, and each read once."""

from __future__ import annotations

import asyncio
import os
from pathlib import Path

from server.abr.clientstatus import ClientStatus
from server.library import Library
from server.operate.prometheus import Metrics
from server.state.caches import ObjectCache
from server.state.register import MAX_ENDED, PlayRegister, StatusOutcome
from tests.support.server.running_server import make_stream


def test_the_cache_is_bounded_and_reads_once(tmp_path: Path) -> None:
    root = make_stream(tmp_path / "s", 30)
    one_bytes = os.path.getsize(root / "segments" / "1" / "0")

    async def check() -> None:
        stream = Library(root, 1.0).streams["s"]
        metrics = Metrics()
        cache = ObjectCache(3 * one_bytes + 100, metrics)
        loaded = await asyncio.gather(*(cache.load(stream, 1, 0) for _ in range(10)))
        assert all(one is loaded[0] for one in loaded)
        assert metrics.cache_misses.value() == 1
        for segment in range(6):
            found = await cache.load(stream, segment, 0)
            assert found.data == stream.read_object(segment, 0).data
            assert cache.size_bytes <= 3 * one_bytes + 100
        hits = metrics.cache_hits.value()
        await cache.load(stream, 5, 0)
        assert metrics.cache_hits.value() == hits + 1
        # An object that is too large by itself is not cached.
        tiny = ObjectCache(10, Metrics())
        assert (await tiny.load(stream, 0, 0)).data == stream.read_object(0, 0).data
        assert tiny.size_bytes == 0

    asyncio.run(check())


def ended(plays: PlayRegister, token: str, rate_bps: float | None, now_s: float) -> None:
    plays.begin(token, "walk").rate_bps = rate_bps
    plays.end(token, now_s)


def test_a_play_reads_the_newest_status_once() -> None:
    plays = PlayRegister()
    entry = plays.begin("a", "walk")
    assert entry.pop_status() is None
    outcomes = [plays.report("a", "walk", ClientStatus(n)) for n in range(1000)]
    assert outcomes == [StatusOutcome.TAKEN] + 999 * [StatusOutcome.REPLACED]
    assert entry.pop_status() == ClientStatus(999)
    assert entry.pop_status() is None
    assert plays.report("a", "walk", ClientStatus(1)) is StatusOutcome.TAKEN


def test_a_status_reaches_only_a_running_play_of_its_own_stream() -> None:
    plays = PlayRegister()
    entry = plays.begin("a", "walk")
    assert plays.report("a", "dance", ClientStatus(1)) is StatusOutcome.UNKNOWN
    assert plays.report("b", "walk", ClientStatus(1)) is StatusOutcome.UNKNOWN
    assert len(plays) == 1
    plays.end("a", 0.0)
    assert plays.report("a", "walk", ClientStatus(1)) is StatusOutcome.UNKNOWN
    assert entry.status is None
    assert len(plays) == 0


def test_who_comes_back_soon_is_known() -> None:
    plays = PlayRegister()
    ended(plays, "a", 5e6, now_s=100.0)
    assert plays.rate_bps("a", 160.0) == 5e6
    assert plays.rate_bps("a", 160.1) is None
    assert plays.rate_bps("b", 100.0) is None
    assert plays.rate_bps("", 100.0) is None


def test_who_seeks_is_known_while_the_old_play_still_runs() -> None:
    plays = PlayRegister()
    entry = plays.begin("a", "walk")
    assert plays.rate_bps("a", 0.0) is None
    entry.rate_bps = 7e6
    assert plays.rate_bps("a", 0.0) == 7e6


def test_a_token_continues_one_play_once_soon_after_its_end() -> None:
    plays = PlayRegister()
    plays.begin("a", "walk")
    assert plays.continue_play("a", 0.0, False) == "running"
    for token, later_s, is_lost, outcomes in (
        ("a", 300.0, False, ["allowed", "refused"]),
        ("b", 300.1, True, ["refused"]),
        ("unknown", 0.0, False, ["refused"]),
        ("of a dead worker", 0.0, True, ["allowed", "refused"]),
    ):
        if len(token) == 1:
            ended(plays, token, None, now_s=100.0)
        assert [plays.continue_play(token, 100.0 + later_s, is_lost) for _ in outcomes] == outcomes
    for n in range(5000):
        ended(plays, str(n), None, now_s=0.0)
    assert plays.continue_play("0", 0.0, False) == "refused"
    assert plays.continue_play("4999", 0.0, False) == "allowed"


def test_only_the_newest_are_remembered() -> None:
    plays = PlayRegister()
    for n in range(5000):
        ended(plays, str(n), 1e6 + n, now_s=0.0)
    known = [n for n in range(5000) if plays.rate_bps(str(n), 0.0) is not None]
    assert known == list(range(5000 - MAX_ENDED, 5000))
