"""A training reports its device memory; a device with less memory is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from codec.errors import InvalidError
from tests.trainer.step.device.test_resident import NUM_GS, WEIGHTS, begin, steps, training
from tests.trainer.step.device.test_torchraster import peak_bytes
from trainer.step.backend import MemoryNeeds
from trainer.step.cpubackend import CpuBackend
from trainer.step.device.devicememory import free_bytes, planned
from trainer.step.device.torchraster import TorchBackend

GPU = MemoryNeeds(200_000, 0, 1352 * 1014, 40, False)


def test_preset_gpu_fits_a_small_gpu_and_pictures_get_what_is_left() -> None:
    plan = planned(GPU, 8 << 30, 512 << 20, 4 << 30, "device cuda")
    assert plan.total_bytes < 4e9
    assert plan.pictures_bytes == 40 * 3 * 1352 * 1014
    tight = planned(GPU, plan.total_bytes - 50_000_000, 512 << 20, 4 << 30, "device cuda")
    assert tight.pictures_bytes == plan.pictures_bytes - 50_000_000
    assert tight.total_bytes == plan.total_bytes - 50_000_000
    bounded = planned(GPU, 8 << 30, 512 << 20, 20_000_000, "device cuda")
    assert bounded.pictures_bytes == 20_000_000
    masked = planned(replace(GPU, has_masks=True), 8 << 30, 512 << 20, 4 << 30, "device cuda")
    assert masked.pictures_bytes * 3 == plan.pictures_bytes * 4


def test_a_device_that_has_less_is_one_line() -> None:
    with pytest.raises(InvalidError, match=r"^device cuda:1 has 1\.00 GB free.*--num-gs") as caught:
        planned(GPU, 10**9, 512 << 20, 4 << 30, "device cuda:1")
    assert "\n" not in str(caught.value)


def test_the_plan_is_said_before_training() -> None:
    line = TorchBackend(*WEIGHTS, "cpu").plan(GPU)
    assert line is not None
    assert line.startswith("memory: ")
    assert "that are free on device cpu" in line
    assert "\n" not in line
    assert CpuBackend(*WEIGHTS).plan(GPU) is None
    assert free_bytes(torch.device("cpu")) > 1 << 28


@pytest.mark.parametrize(("sh_degree", "times"), [(0, 3), (3, 1)])
def test_a_step_keeps_to_the_plan(sh_degree: int, times: int) -> None:
    given = training(sh_degree, times=times)
    backend = TorchBackend(*WEIGHTS, "cpu")
    camera = given.views[0].camera
    needs = MemoryNeeds(NUM_GS, sh_degree, camera.width_px * camera.height_px, 6, True)
    plan = planned(needs, 1 << 40, 16 << 20, 4 << 30, "device cpu")
    resident = backend.start(given)
    begin(resident)
    every = np.arange(NUM_GS, dtype=np.int32)
    selection = resident.select(every, every)
    resident.step(steps(1)[0], selection)
    peak = peak_bytes(lambda: resident.step(steps(1)[0], selection))
    assert peak < plan.step_bytes
    # The plan is not far too large either, apart from the batches that it allows.
    assert peak > 0.15 * (plan.step_bytes - (16 << 20))
