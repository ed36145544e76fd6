"""The benchmark of GPUs at its smallest, with torch's CPU for a GPU."""

from __future__ import annotations

import os
import re
from dataclasses import replace
from pathlib import Path

import pytest

from bench.cuda import CudaConfig, in_a_process, run
from codec.errors import InvalidError
from tests.support.tiny_capture import write_dynamic3dgs


def config(folder: Path, num_frames: int) -> CudaConfig:
    write_dynamic3dgs(folder / "capture", num_cameras=4, num_frames=num_frames)
    (folder / "capture/fps.txt").unlink()  # as downloaded
    return CudaConfig(
        (folder / "capture",), demo=False, frames=(num_frames,), backends=("torch",),
        torch_device="cpu", sizes=(100,), width_px=48, height_px=32, steps=1, num_gs=60,
        genesis_iterations=3, settle_rounds=1, window_iterations=1,
    )  # fmt: skip


def hows(printed: str, capture: str = "capture") -> list[str]:
    """The column "how" of the table's rows for this capture and torch."""
    return re.findall(rf"│\s+{capture} │\s+torch │\s+(\w+) │", printed)


def test_what_a_machine_cannot_do_does_not_end_the_table() -> None:
    failures: list[str] = []
    too_large = "raise RuntimeError('CUDA out of memory.\\nTried to allocate 1 GiB')"
    assert list(in_a_process(failures, "a step", float, "2.5")) == [2.5]
    assert list(in_a_process(failures, "a larger one", exec, too_large)) == []
    assert list(in_a_process(failures, "the largest", os._exit, 3)) == []
    assert failures[0] == "not measured: a larger one: CUDA out of memory."
    assert failures[1].startswith("not measured: the largest: ")
    assert len(failures) == 2


@pytest.mark.deep
def test_each_row_is_measured_in_a_process_and_the_demo_is_filmed_too(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run(replace(config(tmp_path, 2), demo=True, longest_px=96))
    printed = capsys.readouterr().out
    assert hows(printed, "demo") == hows(printed) == ["preset"]


@pytest.mark.deep
def test_parts_are_trained_beside_the_same_in_one_go(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("ray", reason="ray is not installed")
    run(replace(config(tmp_path, 6), ray_workers=2, worker_cpus=1))
    assert hows(capsys.readouterr().out) == ["preset", "slots", "parts"]


def test_a_machine_that_cannot_is_said_before_anything_is_read(tmp_path: Path) -> None:
    with pytest.raises(InvalidError, match="--torch-device abacus"):
        run(CudaConfig((tmp_path / "nothing",), backends=("torch",), torch_device="abacus"))
