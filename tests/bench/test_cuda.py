"""The benchmark of GPUs at its smallest, with torch's CPU for a GPU."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest

from bench.cuda import COLUMNS, CudaConfig, measured, run
from codec.errors import InvalidError
from tests.support.tiny_capture import write_dynamic3dgs


def config(folder: Path) -> CudaConfig:
    write_dynamic3dgs(folder / "capture", num_cameras=5, num_frames=6)
    return CudaConfig(
        folder / "capture", frames=(6,), backends=("torch",), torch_device="cpu", num_gs=200,
        genesis_iterations=20, window_iterations=5,
    )  # fmt: skip


def hows(printed: str) -> list[str]:
    """Of the rows of a table, how each was trained: for 6 frames, by torch."""
    return re.findall(r"│\s+torch │\s+(\w+) │\s+6 │", printed)


def test_a_row_has_time_quality_and_memory(tmp_path: Path) -> None:
    row = measured(config(tmp_path), "torch", "slices", 6)
    assert len(row.texts) == len(COLUMNS)
    assert row.s_per_frame > 0
    assert row.psnr_db > 5
    assert row.host_bytes > 50_000_000
    assert row.bytes_per_frame > 0


def test_the_table_is_one_call(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "120")  # so that no heading is broken
    run(config(tmp_path))
    printed = capsys.readouterr().out
    assert "torch on cpu: 200 Gaussians" in printed
    assert "s/frame" in printed
    assert hows(printed) == ["slices"]


@pytest.mark.slow
def test_parts_are_trained_beside_the_same_in_one_go(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("ray", reason="ray is not installed")
    run(replace(config(tmp_path), ray_workers=2, worker_cpus=1))
    assert hows(capsys.readouterr().out) == ["slices", "slots", "parts"]


def test_a_machine_that_cannot_is_said_before_anything_is_read(tmp_path: Path) -> None:
    with pytest.raises(InvalidError, match="--torch-device abacus"):
        run(CudaConfig(tmp_path / "nothing", backends=("torch",), torch_device="abacus"))
