"""swings-abr from end to end, and the results of its policies."""

from __future__ import annotations

import csv
import json
from functools import partial
from pathlib import Path
from statistics import fmean

import pytest

from server.abr.link.link import Link, LinkStep
from server.study.choice import OWN, POLICIES
from server.study.looped import LoopedMedia
from server.study.plays import Case, Rules, score_play
from tests.support import commands
from tests.support.delivery.media import basketball_media
from tests.support.slots.folder import write_slots


@pytest.fixture(scope="module")
def stream(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("study") / "stream"
    write_slots(path, 16)
    return path


@pytest.fixture(scope="module")
def traces(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of three traces in both formats."""
    path = tmp_path_factory.mktemp("traces")
    (path / "lte").mkdir()
    for name, rates in (("fast", (4000, 900)), ("slow", (700, 300, 1500))):
        steps = [{"duration_ms": 800, "bandwidth_kbps": r, "latency_ms": 25} for r in rates]
        (path / "lte" / f"{name}.json").write_text(json.dumps(steps))
    (path / "mahimahi").write_text("".join(f"{n}\n" for n in range(0, 900, 7)))
    return path


def test_swings_abr(stream: Path, traces: Path, tmp_path: Path) -> None:
    """A table, every play as CSV, and a picture, from two processes."""
    out = tmp_path / "deep" / "report"
    own = "bench/abr/dynamic.py:Dynamic"
    told = commands.run_ok(
        "swings-abr", stream, "--traces", traces, "--out", out, "--jobs", 2, "--generate", 1,
        "--length", 4, "--loads", 0.7, 1.5, "--seed", 5, "--half", "tune", "--policy", f"all,{own}",
        folder=commands.ROOT,
    )  # fmt: skip
    assert str(out / "plays.csv") in told
    assert {path.name for path in out.iterdir()} == {"plays.csv", "plays.png"}
    assert (out / "plays.png").read_bytes().startswith(b"\x89PNG")
    plays = list(csv.DictReader((out / "plays.csv").read_text().splitlines()))
    assert [one["policy"] for one in plays[:6]] == [*POLICIES, "Dynamic"]
    assert [one["trace"] for one in plays[:18:6]] == [
        "mahimahi",
        "lte/fast.json",
        "generated/000005",
    ]
    assert len({(one["trace"], one["load"], one["policy"]) for one in plays}) == len(plays) == 36
    for one in plays:
        assert 1 <= float(one["layers"]) <= 2
        assert float(one["quality_db"]) < float(one["psnr_db"])
    ours = [float(one["quality_db"]) for one in plays if one["policy"] == OWN]
    (row,) = (line.split() for line in told.splitlines() if line.split()[:2] == ["all", OWN])
    assert row[2] == f"{fmean(ours):.2f}"


def test_a_study_that_cannot_be_written_or_named_is_refused(stream: Path, tmp_path: Path) -> None:
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "file").touch()
    run = partial(commands.run, "swings-abr", stream, "--generate", 1, "--length", 1)
    for options, status, message in (
        (["--out", tmp_path / "full"], 1, "is not empty"),
        (["--policy", "best"], 2, "policy 'best' is unknown"),
        (["--policy", "sweep,sweep.py:sweep"], 2, "sweep.py: No such file"),
        (["--loads", 1, 1], 2, "each only once"),
    ):
        ended = run(*options)
        assert ended.returncode == status, ended.stderr
        assert message in " ".join(ended.stderr.split())


LINKS = {
    "steady": ((10.0, 0.8),),
    "swings": ((4.0, 1.7), (2.5, 0.3), (1.5, 0.9)),
    "outage": ((7.0, 1.2), (6.0, 0.0), (5.0, 0.5)),
}
"""Seconds, and rate as a share of what all layers take."""
GOLDEN = {
    ("throughput", "steady"): (28.2841, 0.0000, 0, 1.9500),
    ("throughput", "swings"): (28.7734, 0.0000, 0, 3.1566),
    ("throughput", "outage"): (20.2615, 5.1034, 6, 3.0783),
    ("bola", "steady"): (28.2841, 0.0000, 0, 1.9500),
    ("bola", "swings"): (29.0128, 0.0000, 0, 3.2689),
    ("bola", "outage"): (19.9378, 5.1034, 6, 2.4283),
    ("robust_mpc", "steady"): (28.5520, 0.0000, 0, 2.6500),
    ("robust_mpc", "swings"): (28.5381, 0.0000, 0, 2.8066),
    ("robust_mpc", "outage"): (20.0334, 5.0717, 8, 2.6283),
    ("tail_drop", "steady"): (28.2841, 0.0000, 0, 1.9500),
    ("tail_drop", "swings"): (28.7373, 0.0000, 0, 3.1116),
    ("tail_drop", "outage"): (20.7803, 4.7701, 4, 3.0283),
    ("sweep", "steady"): (28.3598, 0.0000, 0, 2.5250),
    ("sweep", "swings"): (29.1437, 0.0000, 0, 3.5287),
    ("sweep", "outage"): (26.8093, 0.6587, 4, 1.7643),
}
"""QoE in dB, seconds of stalls, stalls and mean layers, as of commit 2d159e4a."""


@pytest.mark.parametrize(("policy", "link"), GOLDEN)
def test_the_results_of_a_policy_stay(policy: str, link: str) -> None:
    media = LoopedMedia((basketball_media().sizes(0),), 600, 30.0, 30)
    steps = [LinkStep(time_s, share * media.need_bps, 0.03) for time_s, share in LINKS[link]]
    play = score_play(media, Case(link, 1.0, Link(steps)), policy, Rules())
    stalled_s = play.rebuffering * media.length_s
    found = (play.quality_db, stalled_s, play.stalls, play.layers)
    assert found == pytest.approx(GOLDEN[policy, link], abs=1e-4)
