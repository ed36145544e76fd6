"""swings-abr from end to end, and the results of its policies."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from statistics import fmean

import pytest

from server.abr.link import Link, LinkStep
from server.study.choice import OWN, POLICIES
from server.study.config import Rules
from server.study.looped import LoopedMedia
from server.study.study import Case, score_play
from tests.support import commands
from tests.support.delivery.media import basketball_media
from tests.support.slots.folder import write_slots


def test_swings_abr(tmp_path: Path) -> None:
    """A table, every play as CSV, and a picture, from two processes."""
    write_slots(tmp_path / "stream", 16)
    traces, out = tmp_path / "traces", tmp_path / "deep" / "report"
    (traces / "lte").mkdir(parents=True)
    for name, rates in (("fast", (4000, 900)), ("slow", (700, 300, 1500))):
        steps = [{"duration_ms": 800, "bandwidth_kbps": r, "latency_ms": 25} for r in rates]
        (traces / "lte" / f"{name}.json").write_text(json.dumps(steps))
    (traces / "mahimahi").write_text("".join(f"{n}\n" for n in range(0, 900, 7)))
    words = (
        tmp_path / "stream", "--traces", traces, "--out", out, "--jobs", 2, "--generate", 1,
        "--length", 4, "--loads", 0.7, 1.5, "--seed", 5, "--half", "tune",
        "--policy", "all,bench/abr/dynamic.py:Dynamic",
    )  # fmt: skip
    done = commands.run("swings-abr", *words, folder=commands.ROOT)
    assert done.returncode == 0, done.stderr
    assert "its index has no PSNR" in done.stderr
    assert {path.name for path in out.iterdir()} == {"plays.csv", "plays.png"}
    assert (out / "plays.png").read_bytes().startswith(b"\x89PNG")
    plays = list(csv.DictReader((out / "plays.csv").read_text().splitlines()))
    assert [one["policy"] for one in plays[:6]] == [*POLICIES, "Dynamic"]
    names = ["mahimahi", "lte/fast.json", "generated/000005"]
    assert [one["trace"] for one in plays[::6]] == 2 * names
    for one in plays:
        assert 1 <= float(one["layers"]) <= 2
        assert float(one["quality_db"]) < float(one["psnr_db"])
    ours = [float(one["quality_db"]) for one in plays if one["policy"] == OWN]
    rows = [line.split() for line in done.stdout.splitlines()]
    assert [row[2] for row in rows if row[:2] == ["all", OWN]] == [f"{fmean(ours):.2f}"]
    again = commands.run("swings-abr", *words, folder=commands.ROOT)
    assert (again.returncode, again.stdout) == (1, "")
    assert "is not empty" in again.stderr


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
