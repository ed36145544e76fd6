"""The ladder beside dedicated streams: the search for equal bytes, and the area between curves."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

import bench.ladder
from bench.ablate import Outcome, Outcomes, Setting
from bench.bjontegaard import RatePoint, bd_psnr_db, bd_rate
from bench.ladder import DEDICATED, TOLERANCE, LadderConfig, run
from codec.errors import InvalidError
from tests.support.hostile import refused

CURVE = [RatePoint(rate, db) for rate, db in ((5e3, 24), (8e3, 26.5), (2e4, 28), (4e4, 28.7))]


def moved(by_rate: float, by_db: float) -> list[RatePoint]:
    return [RatePoint(p.bytes_per_frame * (1 + by_rate), p.psnr_db + by_db) for p in CURVE]


@given(st.floats(-0.5, 1.0), st.floats(-1.0, 1.0))
def test_a_curve_that_is_moved_has_just_this_area(by_rate: float, by_db: float) -> None:
    assert bd_rate(moved(by_rate, 0), CURVE) == pytest.approx(by_rate, abs=1e-9)
    assert bd_psnr_db(moved(0, by_db), CURVE) == pytest.approx(by_db, abs=1e-9)
    there, back = bd_psnr_db(moved(by_rate, 0), CURVE), bd_psnr_db(CURVE, moved(by_rate, 0))
    assert there is not None
    assert back == pytest.approx(-there, abs=1e-9)
    # A point that another beats with fewer bytes is not on a curve.
    assert bd_rate([*CURVE, RatePoint(3e4, 25)], CURVE) == pytest.approx(0, abs=1e-9)


def test_curves_without_a_common_range_have_no_area() -> None:
    assert bd_psnr_db(moved(20, 0), CURVE) is None
    assert bd_rate(moved(0, 20), CURVE) is None
    assert bd_rate(CURVE[:1], CURVE) is None


def test_dedicated_streams_are_searched_until_they_have_the_bytes_of_each_rung(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    trained = list[Setting]()

    def measure(config: LadderConfig, chosen: list[Setting]) -> Outcomes:
        (setting,) = chosen
        trained.append(setting)
        sizes = [
            setting.fit.num_gs * sum(setting.layers[: n + 1]) for n in range(len(setting.layers))
        ]
        share = setting.fit.lease.active_share
        rates = [900 + 3 * size**0.95 * (0.2 + share) for size in sizes]
        gain_db = 0.5 if setting.group == DEDICATED else 0.0
        levels_db = [20 + rate**0.2 + gain_db for rate in rates]
        outcome = Outcome(0, None, 0, None, 0, levels_db, rates, 0)
        return {setting: [outcome] * config.seeds}

    monkeypatch.setattr(bench.ladder, "measure", measure)
    config = LadderConfig(tmp_path, out=tmp_path / "plots" / "ladder.png", seeds=2)
    console = Console(width=100)
    monkeypatch.setattr(bench.ladder, "Console", lambda width: console)
    with console.capture() as shown:
        run(config)
    lines = shown.get().splitlines()
    assert lines[-1].startswith("BD-PSNR -0.50 dB")
    assert config.out.read_bytes().startswith(b"\x89PNG")
    rows = [line.replace(",", "").split() for line in lines if line.startswith("|")][2:]
    ladder_kb = [float(row[7]) for row in rows if row[1] != DEDICATED]
    assert len(ladder_kb) == len(config.layers)
    for share in config.active_shares:
        mine_kb = [float(row[7]) for row in rows if row[1] == DEDICATED and float(row[5]) == share]
        for kb in ladder_kb:
            assert min(abs(mine / kb - 1) for mine in mine_kb) <= TOLERANCE + 0.01
        assert len(mine_kb) <= 3 * len(ladder_kb)
    assert all(setting.layers == (1.0,) for setting in trained[1:])
    refused(InvalidError, "two layers", run, replace(config, layers=(1.0,)))
