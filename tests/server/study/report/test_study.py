"""swings-abr from end to end: a report that depends only on its settings, and clear errors."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import pytest

from server.study.policies.choice import POLICIES
from tests.support import commands
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


@pytest.fixture(scope="module")
def report(stream: Path, traces: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A report from the command, with two processes."""
    out = tmp_path_factory.mktemp("out") / "deep" / "report"
    told = commands.run_ok(
        "swings-abr", stream, "--traces", traces, "--out", out, "--jobs", 2, "--generate", 1,
        "--length", 4, "--loads", 0.7, 1.5, "--seed", 5, "--half", "tune", "--as-bitrate", "36M",
    )  # fmt: skip
    assert "sweep" in told
    assert str(out / "index.html") in told
    return out


def test_the_report_is_whole(report: Path) -> None:
    names = {path.name for path in report.iterdir()}
    assert names == {"index.html", "plays.csv", "summary.json"}
    assert [path.name for path in report.parent.iterdir()] == ["report"]
    plays = list(csv.DictReader((report / "plays.csv").read_text().splitlines()))
    assert len(plays) == 3 * 2 * len(POLICIES)
    assert len({(one["trace"], one["load"], one["policy"]) for one in plays}) == len(plays)
    for one in plays:
        # The oracle's value is an upper bound.
        assert float(one["quality_db"]) <= float(one["oracle_quality_db"]) + 1e-3
        assert float(one["oracle_base_db"]) <= float(one["oracle_quality_db"])
        assert 1 <= float(one["layers"]) <= 2
        waited_s, least_s = (
            float(one[f"{who}startup_s"]) + 4 * float(one[f"{who}rebuffering"])
            for who in ("", "oracle_")
        )
        assert waited_s >= least_s - 1e-3
        assert 0 <= float(one["wasted"]) < 1
    summary = json.loads((report / "summary.json").read_text())
    assert summary["traces"] == ["mahimahi", "lte/fast.json", "generated/000005"]
    assert summary["need_bps"] == pytest.approx(36e6)
    assert [one["load"] for one in summary["loads"]] == [0.7, 1.5, None]
    assert not summary["knows_psnr"]
