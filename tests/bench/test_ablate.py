"""The comparison of the paper's choices at its smallest: it runs, keeps results, and draws."""

from __future__ import annotations

from pathlib import Path

import pytest
from rich.console import Console

import bench.ablate
from bench.ablate import AblateConfig, measure, settings, table_of
from tests.support.tiny_capture import write_dynamic3dgs


def test_it_measures_once_and_draws(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_dynamic3dgs(tmp_path / "capture", num_cameras=4, num_frames=3)
    config = AblateConfig(
        tmp_path / "capture",
        out=tmp_path / "plots" / "ablate.png",
        work=tmp_path / "work",
        frames="0:3",
        scale=1.0,
        genesis_iterations=3,
        window_iterations=2,
        age_num_gs=60,
        age_swin_size=2,
        swin_sizes=(1, 2),
        slice_size=40,
        seeds=1,
    )
    outcomes = measure(config, settings(config))
    assert list(outcomes) == settings(config)
    assert all(setting.whole_slices for setting in outcomes)
    assert {setting.fit.num_gs / setting.fit.swin_size for setting in outcomes} == {30, 40}
    assert all(len(found) == 1 and found[0].psnr_db > 3 for found in outcomes.values())

    def fail(*arguments: object) -> None:
        raise AssertionError("trained again")

    monkeypatch.setattr(bench.ablate, "train_stream", fail)
    assert measure(config, settings(config)) == outcomes
    console = Console(width=130)
    with console.capture() as shown:
        console.print(table_of(outcomes))
    assert all(setting.name in shown.get() for setting in outcomes)
    bench.ablate.draw(outcomes, config)
    assert config.out.read_bytes().startswith(b"\x89PNG")
