"""A named backend is used or refused; auto uses the best one that works, and states why."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import torch

from codec.errors import InvalidError
from tests.support.hostile import refused
from trainer.step.backend import BackendName, Resident, StepInput, Training
from trainer.step.cpubackend import CpuBackend
from trainer.step.device import pick
from trainer.step.device.backends import CudaBackend, TorchBackend
from trainer.step.device.pick import Weights, pick_backend
from trainer.step.loss import Loss
from trainer.step.raster import Parameters

WEIGHTS = Weights(0.2, 0.01, 0.02)
HAS_GPU = torch.cuda.is_available() or torch.xpu.is_available()


def plain_torch(_: Weights, __: str = "") -> TorchBackend:
    """A replacement for a device that this machine lacks."""
    return TorchBackend(0.2, 0.01, 0.02, "cpu")


class Faulty(TorchBackend):
    """A device with a fault."""

    fault = ""

    def step(self, given: StepInput, gradients: Parameters) -> Loss:
        if self.fault == "lacks an operation":
            raise NotImplementedError("no cumprod here\nsecond line")
        loss = super().step(given, gradients)
        if self.fault == "gradients are not numbers":
            gradients.means[0] = np.nan
        return replace(loss, value=1.01 * loss.value) if self.fault == "wrong" else loss

    def start(self, training: Training) -> Resident:
        resident = super().start(training)
        if self.fault == "updates have no effect":
            training.values.means[:] += 1
            resident.fetch = lambda history=False: None  # type: ignore[method-assign]
        return resident


def not_installed(_: Weights) -> CudaBackend:
    raise ImportError("gsplat was built for another torch")


@pytest.mark.skipif(HAS_GPU or torch.backends.mps.is_available(), reason="torch has a GPU here")
def test_without_a_gpu_torch_runs_on_the_cpu_and_auto_takes_numba() -> None:
    for device in (None, "cpu"):
        named = pick_backend("torch", WEIGHTS, device)
        assert isinstance(named.backend, TorchBackend)
        assert named.why == "torch on cpu"
    assert isinstance(pick_backend("cpu", WEIGHTS).backend, CpuBackend)
    picked = pick_backend("auto", WEIGHTS)
    assert isinstance(picked.backend, CpuBackend)
    assert picked.why == (
        "cpu (numba), the best without cuda (torch sees no NVIDIA GPU) and torch (no GPU)"
    )
    refused(InvalidError, r"no NVIDIA GPU.*pip install '\.\[cuda\]'", pick_backend, "cuda", WEIGHTS)


def test_without_torch_that_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pick, "find_spec", lambda name: None)
    picked = pick_backend("auto", WEIGHTS)
    assert isinstance(picked.backend, CpuBackend)
    assert picked.why == "cpu (numba), the best without cuda (torch is not installed)"
    refused(InvalidError, r"pip install '\.\[torch\]'", pick_backend, "torch", WEIGHTS)
    refused(InvalidError, "torch is not installed", pick_backend, "cuda", WEIGHTS)


def test_auto_prefers_gsplat_then_torch_on_a_device(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pick, "_cuda_lacks", lambda: None)
    monkeypatch.setattr(pick, "_accelerator", lambda: "mps")
    monkeypatch.setattr(pick, "_cuda", plain_torch)
    monkeypatch.setattr(pick, "_plain", plain_torch)
    assert pick_backend("auto", WEIGHTS).why == "cuda (gsplat), the best"
    monkeypatch.setattr(pick, "_cuda", not_installed)
    assert pick_backend("auto", WEIGHTS).why == (
        "torch on mps, the best without cuda (gsplat was built for another torch)"
    )
    refused(InvalidError, r"--backend cuda.*built for another torch", pick_backend, "cuda", WEIGHTS)


@pytest.mark.parametrize(
    ("fault", "said"),
    [
        ("lacks an operation", r"no cumprod here"),
        ("wrong", r"its loss in a trial is 0\.\d+, not 0\.\d+"),
        ("gradients are not numbers", r"its loss in a trial is nan, not 0\.\d+"),
        ("updates have no effect", r"its loss in a trial is nan, not 0\.\d+"),
    ],
)
def test_faulty_devices_are_refused(monkeypatch: pytest.MonkeyPatch, fault: str, said: str) -> None:
    def plain(weights: Weights, device: str) -> TorchBackend:
        backend = Faulty(0.2, 0.01, 0.02, "cpu")
        backend.fault = fault if device == "mps" else ""
        return backend

    monkeypatch.setattr(pick, "_cuda_lacks", lambda: "no GPU")
    monkeypatch.setattr(pick, "_accelerator", lambda: "mps")
    monkeypatch.setattr(pick, "_plain", plain)
    picked = pick_backend("auto", WEIGHTS)
    assert isinstance(picked.backend, CpuBackend)
    assert "\n" not in picked.why
    with pytest.raises(InvalidError, match=f"torch on mps does not work here: {said}$"):
        pick_backend("torch", WEIGHTS)


def test_a_device_that_is_not_there_or_not_for_torch_is_one_line() -> None:
    for device in ("abacus", "cuda:93", "meta:x", "vulkan"):
        says = f"^--torch-device {device}: torch cannot use it"
        told = str(refused(InvalidError, says, pick_backend, "torch", WEIGHTS, device))
        assert "\n" not in told
        assert len(told) < 300
    names: tuple[BackendName, ...] = ("cpu", "cuda", "auto")
    for name in names:
        with pytest.raises(InvalidError, match="--torch-device cpu is for --backend torch"):
            pick_backend(name, WEIGHTS, "cpu")


def test_numba_needs_no_torch() -> None:
    code = (
        "import sys; from trainer.fit.config import FitConfig; FitConfig().backend('cpu'); "
        "sys.exit('torch' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
