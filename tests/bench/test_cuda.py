"""The benchmark of GPUs at its smallest, with torch's CPU for a GPU."""

from __future__ import annotations

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


def test_a_row_has_time_quality_and_memory(tmp_path: Path) -> None:
    row = measured(config(tmp_path), "torch", 6)
    assert len(row.texts) == len(COLUMNS)
    assert row.s_per_frame > 0
    assert row.psnr_db > 5
    assert row.host_bytes > 50_000_000
    assert row.bytes_per_frame > 0


def test_the_table_is_one_call(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run(config(tmp_path))
    printed = capsys.readouterr().out
    assert "torch on cpu: 200 Gaussians" in printed
    assert "s/frame" in printed
    assert "│   torch │      6 │" in printed


def test_a_machine_that_cannot_is_said_before_anything_is_read(tmp_path: Path) -> None:
    with pytest.raises(InvalidError, match="--torch-device abacus"):
        run(CudaConfig(tmp_path / "nothing", backends=("torch",), torch_device="abacus"))
