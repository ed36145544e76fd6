"""A signal in the middle of a play: the requested file is complete, or absent."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.commands import ROOT
from tests.support.hosted_streams import served, write_stream
from tests.support.waiting import BOUND_S, wait_until


@pytest.mark.parametrize(
    ("capture", "number"),
    [("out.mp4", signal.SIGTERM), ("pictures", signal.SIGINT)],
)
def test_a_signal_writes_the_report_and_no_half_video(
    tmp_path: Path, capture: str, number: signal.Signals
) -> None:
    (tmp_path / "library").mkdir()
    write_stream(tmp_path / "library" / "long", 300)
    folder = tmp_path / "out"
    folder.mkdir()
    out, report = folder / capture, folder / "report.json"
    options = ["--size", "32x24", "--renderer", "cpu", "--link", "20M,2ms", "--loop", "9"]
    with served(tmp_path / "library") as server:
        player = subprocess.Popen(
            [
                *(sys.executable, "-m", "player", server.url, *options),
                *("--capture", str(out), "--report", str(report)),
            ],
            cwd=ROOT,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        # A picture, or the unfinished video.
        begun = "pictures/frame_00002.png" if capture == "pictures" else ".out.mp4.tmp"
        wait_until((folder / begun).exists)
        player.send_signal(number)
        told = player.communicate(timeout=BOUND_S)
    assert (player.returncode, *told) == (128 + number, "", "")
    names = sorted(path.name for path in folder.iterdir())
    assert names == (["pictures", "report.json"] if capture == "pictures" else ["report.json"])
    summary = json.loads(report.read_text())
    assert summary["interrupted"]
    assert len(summary["frames"]) == summary["totals"]["frames"] - drawn_too_late(summary)
    assert sum(one["bytes"] for one in summary["arrivals"]) >= summary["totals"]["bytes"] > 0
    assert summary["totals"]["link_bytes"] > summary["totals"]["bytes"]
    assert {one["link_bps"] for one in summary["rates"]} == {20e6}
    if capture == "pictures":
        assert summary["totals"]["frames"] >= 3


def drawn_too_late(summary: dict[str, dict[str, int]]) -> int:
    """Number of frames that were due but not drawn yet; at most the length of the queue."""
    on_their_way = summary["totals"]["frames"] - len(summary["frames"])
    assert 0 <= on_their_way <= 4
    return on_their_way
