"""The benchmark of GPUs at its smallest, with torch's CPU for a GPU."""

from __future__ import annotations

import os
import re
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from bench.cuda import COLUMNS, CudaConfig, in_a_process, measured, run
from bench.gpusteps import STEP_COLUMNS, StepCase, measured_step
from codec.errors import InvalidError
from tests.support.tiny_capture import write_dynamic3dgs


def config(folder: Path) -> CudaConfig:
    write_dynamic3dgs(folder / "capture", num_cameras=5, num_frames=6)
    (folder / "capture/fps.txt").unlink()  # as downloaded
    return CudaConfig(
        (folder / "capture",), demo=False, frames=(6,), backends=("torch",), torch_device="cpu",
        sizes=(300,), width_px=96, height_px=64, steps=3, num_gs=200, genesis_iterations=20,
        settle_rounds=1, window_iterations=5,
    )  # fmt: skip


def hows(printed: str) -> list[str]:
    """The column "how" of the table's rows for 6 frames and torch."""
    return re.findall(r"│\s+capture │\s+torch │\s+(\w+) │\s+6 │", printed)


def test_a_row_has_time_quality_and_memory(tmp_path: Path) -> None:
    given = config(tmp_path)
    row = measured(given, given.captures[0], "torch", "preset", 6)
    assert len(row.texts) == len(COLUMNS)
    assert row.later_s_per_frame is not None
    assert 0 < row.later_s_per_frame < row.s_per_frame
    assert row.psnr_db > 5
    assert row.host_bytes > 50_000_000
    assert row.bytes_per_frame > 0


def test_a_step_has_its_bound_and_sends_numbers_alone() -> None:
    row = measured_step(StepCase("torch", "cpu", 500, 96, 64, 4))
    assert len(row.texts) == len(STEP_COLUMNS)
    assert 0 < row.crossed_bytes < 200
    assert 0.2 < row.ms / row.bare_ms < 20


def test_the_tables_are_one_call(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run(config(tmp_path))
    printed = capsys.readouterr().out
    assert "torch on cpu: steps" in printed
    assert "bytes/step" in printed
    assert re.search(r"│\s+torch │\s+300 │\s+96x64 │", printed)
    assert "torch on cpu: preset gpu, 200 Gaussians" in printed
    assert "s/frame" in printed
    assert hows(printed) == ["preset"]


def lacks_memory() -> float:
    raise torch.OutOfMemoryError("CUDA out of memory.\nTried to allocate 1 GiB")


def dies() -> float:
    os._exit(3)


def test_what_a_machine_cannot_do_does_not_end_the_table() -> None:
    failures: list[str] = []
    assert list(in_a_process(failures, "a step", float, "2.5")) == [2.5]
    assert list(in_a_process(failures, "a larger one", lacks_memory)) == []
    assert list(in_a_process(failures, "the largest", dies)) == []
    assert failures[0] == "not measured: a larger one: CUDA out of memory."
    assert failures[1].startswith("not measured: the largest: ")
    assert len(failures) == 2


@pytest.mark.slow
def test_the_demo_is_filmed_and_trained_too(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run(replace(config(tmp_path), captures=(), demo=True, frames=(2,), longest_px=96))
    assert re.search(r"│\s+demo │\s+torch │\s+preset │\s+2 │", capsys.readouterr().out)


@pytest.mark.slow
def test_parts_are_trained_beside_the_same_in_one_go(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("ray", reason="ray is not installed")
    run(replace(config(tmp_path), ray_workers=2, worker_cpus=1))
    assert hows(capsys.readouterr().out) == ["preset", "slots", "parts"]


def test_a_machine_that_cannot_is_said_before_anything_is_read(tmp_path: Path) -> None:
    with pytest.raises(InvalidError, match="--torch-device abacus"):
        run(CudaConfig((tmp_path / "nothing",), backends=("torch",), torch_device="abacus"))
