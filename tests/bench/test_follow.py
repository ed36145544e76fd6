"""scripts/bench follow and shuffled: real commands and a real player, from files to pictures."""

from __future__ import annotations

import json
import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from bench.follow import WRITTEN_NAME, FollowConfig, run, write
from codec.errors import InvalidError
from codec.sequence.survey import find_files, read_frame


def test_the_writer_keeps_its_rate(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    now_s = [1e9]
    clock = SimpleNamespace(time=lambda: now_s[-1], sleep=lambda s: now_s.append(now_s[-1] + s))
    monkeypatch.setattr("bench.follow.time", clock)
    config = FollowConfig(gaussians=50, fps=20, seconds=0.5, join_s=0.1)
    write(config, tmp_path)
    written_s = json.loads((tmp_path / WRITTEN_NAME).read_text())
    files = find_files(tmp_path)
    assert len(files) == len(written_s) == 10
    assert np.diff(written_s) == pytest.approx(1 / 20, abs=1e-6)
    assert {read_frame(file).sh_degree for file in files} == {3}
    with pytest.raises(InvalidError, match="more seconds"):
        FollowConfig(seconds=5, join_s=5)


@pytest.mark.realtime
def test_pictures_come_of_files(capfd: pytest.CaptureFixture[str]) -> None:
    run(FollowConfig(gaussians=300, seconds=5, join_s=0.5, sh_degree=1))
    told = capfd.readouterr().out
    row = re.search(r"300 +│ 1 +│ 10 +│ (\d+) +│ ([0-9.]+) s", told)
    assert row is not None, told
    assert int(row[1]) > 1
    assert 0 < float(row[2]) < 60
    assert "finished with" in told
    assert "s from a file to its segment" in told
