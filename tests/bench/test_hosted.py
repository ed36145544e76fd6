from __future__ import annotations

import json
from pathlib import Path

import pytest

from bench.network.hosted import HostedConfig, run
from tests.support.web.nodeprocess import NODE


@pytest.mark.skipif(NODE is None, reason="needs Node.js: apt-get install nodejs")
def test_plays_of_a_static_host_are_scored(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whole objects score lower than packets, and higher than layer 0 alone."""
    monkeypatch.setenv("COLUMNS", "200")
    steps = [{"duration_ms": 3000, "bandwidth_kbps": 8000, "latency_ms": 20}]
    (tmp_path / "steady.json").write_text(json.dumps(steps))
    run(HostedConfig(tmp_path, half="all", loads=(1.5,), length_s=20))
    rows = [line.split("│") for line in capsys.readouterr().out.splitlines() if "│" in line]
    normalised = {(row[1].strip(), row[3].strip()): float(row[5]) for row in rows}
    assert len(normalised) == 4
    for stream in ("basketball", "room"):
        hosted = normalised[stream, "browser, whole objects"]
        served = normalised[stream, "server, packets"]
        assert 0.3 < hosted < served < 1
