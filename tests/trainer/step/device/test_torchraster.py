"""Plain torch draws and differentiates like the CPU's kernels, in the planned memory."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch.profiler import ProfilerActivity, profile

from codec.arrays import Ints
from codec.camera import Camera
from codec.errors import InvalidError
from tests.support.reference_render import turned_camera
from tests.trainer.step.device.test_resident import NUM_GS, begin, steps, training
from trainer.pictures.scale import Shot
from trainer.step.backend import Backend, MemoryNeeds, Selection, StepInput
from trainer.step.cpubackend import CpuBackend
from trainer.step.device.backends import TorchBackend
from trainer.step.device.device import planned
from trainer.step.device.torchrender import (
    CONIC_A,
    CONIC_C,
    DRAWN,
    OPACITY,
    PAIR_BYTES,
    RED,
    SLAB,
    TensorLists,
    X,
    Y,
    blend,
)
from trainer.step.loss import Loss
from trainer.step.raster import Parameters, View

WEIGHTS = (0.2, 0.01, 0.02)
NEAR_M = 0.2


def scene(count: int, seed: int, sh_degree: int = 0) -> Parameters:
    """Gaussians, some behind the camera or outside the picture, some opaque, some too faint."""
    rng = np.random.default_rng(seed)
    values = Parameters.zeros(count, sh_degree)
    values.means[:] = rng.uniform(-2, 2, (count, 3))
    values.log_scales[:] = rng.normal(-2.5, 0.9, (count, 3))
    values.quats[:] = rng.normal(size=(count, 4))
    values.logit_opacities[:] = rng.normal(0, 3.5, count)
    values.sh[:] = rng.normal(size=values.sh.shape)
    return values


def shot_of(camera: Camera, seed: int, masked: bool = False, half: bool = False) -> Shot:
    """A shot of the camera's size, at full size or as half of a picture of twice that size."""
    rng, factor = np.random.default_rng(seed), 2 if half else 1
    size = factor * camera.height_px, factor * camera.width_px
    picture = rng.integers(0, 256, (*size, 3), dtype=np.uint8)
    shot = Shot(picture, (rng.random(size) > 0.3).astype(np.uint8) if masked else None)
    return shot.half() if half else shot


def stepped(
    backend: Backend,
    values: Parameters,
    camera: Camera,
    rows: Ints,
    trainable: int,
    shot: Shot,
    whole: bool = True,
) -> tuple[Loss, Parameters]:
    """Loss and gradients of a step; gradients are 7 where nothing was written."""
    gradients = Parameters(*(np.full_like(a, 7) for a in values.arrays))
    gain, bias = np.array([1.1, 0.9, 1], np.float32), np.array([0.02, -0.01, 0], np.float32)
    view = View.prepare(camera, NEAR_M)
    given = StepInput(values, rows, view, shot, gain, bias, trainable, whole)
    return backend.step(given, gradients), gradients


@given(
    seed=st.integers(0, 2**31),
    count=st.integers(1, 400),
    sh_degree=st.integers(0, 3),
    masked=st.booleans(),
    trained=st.floats(0, 1),
    batch_bytes=st.sampled_from([1, 3 * SLAB * PAIR_BYTES, 1 << 30]),
)
@settings(max_examples=25, deadline=None)
def test_gradients_are_the_cpu_s_on_any_scene(
    seed: int, count: int, sh_degree: int, masked: bool, trained: float, batch_bytes: int
) -> None:
    values, camera = scene(count, seed, sh_degree), turned_camera()
    rng = np.random.default_rng(seed)
    rows = np.sort(rng.permutation(count)[: rng.integers(1, count + 1)]).astype(np.int32)
    given = (values, camera, rows, round(trained * count), shot_of(camera, seed, masked))
    wanted, expected = stepped(CpuBackend(*WEIGHTS), *given)
    found, got = stepped(TorchBackend(*WEIGHTS, "cpu", batch_bytes), *given)
    assert found.value == pytest.approx(wanted.value, rel=1e-5)
    for a, b in zip(got.arrays, expected.arrays, strict=True):
        moved = b != 7
        np.testing.assert_array_equal(a != 7, moved)
        scale = np.abs(b[moved]).max(initial=0)
        off = ~np.isclose(a, b, rtol=5e-3, atol=1e-3 * scale)
        # A pixel differs if an alpha rounds to the other side of the visibility threshold.
        assert off.sum() <= max(3, 0.01 * off.size)
        np.testing.assert_allclose(a[off], b[off], atol=0.05 * scale)


@pytest.mark.parametrize("rows", [[], [0], [0, 1]])
def test_nothing_that_shows_gives_a_black_picture_and_no_gradient(rows: list[int]) -> None:
    """No rows; one behind the camera; one in its centre and one far outside the picture."""
    camera = turned_camera()
    values = scene(2, 0)
    behind = camera.position - 2 * camera.w2c[2, :3]
    values.means[0] = behind if len(rows) == 1 else camera.position
    values.means[1] = 1e4, 0, 0
    given = (values, camera, np.array(rows, np.int32), 2, shot_of(camera, 0))
    wanted, expected = stepped(CpuBackend(*WEIGHTS), *given)
    found, got = stepped(TorchBackend(*WEIGHTS, "cpu"), *given)
    assert found.value == pytest.approx(wanted.value, rel=1e-6)
    for a, b in zip(got.arrays, expected.arrays, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-5)
    assert (got.means[rows] == 0).all()


def test_a_pixel_ends_where_the_recipe_says() -> None:
    """A hundred walls in a row: after the first one, 0.01 of the light is left, and the second one
    would leave less than the recipe allows."""
    values, camera = scene(100, 0), replace(turned_camera(), w2c=np.eye(4))
    values.means[:] = np.stack([np.zeros(100), np.zeros(100), np.linspace(2, 3, 100)], 1)
    values.log_scales[:], values.logit_opacities[:] = 3, 8
    rows = np.arange(100, dtype=np.int32)
    given = (values, camera, rows, 100, shot_of(camera, 0))
    _, expected = stepped(CpuBackend(0.2, 0, 0), *given)
    _, got = stepped(TorchBackend(0.2, 0, 0, "cpu"), *given)
    for found in (got, expected):
        assert (found.sh[0] != 0).any()
        assert (found.sh[1:] == 0).all()
    np.testing.assert_allclose(got.sh, expected.sh, rtol=1e-4)


def peak_bytes(work: Callable[[], object]) -> int:
    """Peak of torch's CPU memory during `work`."""
    with profile(activities=[ProfilerActivity.CPU], profile_memory=True) as profiled:
        work()
    events = [e for e in profiled.profiler.kineto_results.events() if e.name() == "[memory]"]
    events.sort(key=lambda event: event.start_ns())
    return int(np.cumsum([event.nbytes() for event in events]).max())


def test_memory_of_blending_is_bounded_whatever_the_lists_hold() -> None:
    """Sixty tiles contain all Gaussians each, which are so faint that no pixel ends."""
    tiles, batch_bytes, rng, peaks = 60, 8 << 20, np.random.default_rng(0), []
    for count in (200, 2_000):
        values = np.zeros((count, DRAWN), np.float32)
        values[:, [X, Y]] = rng.uniform(0, 160, (count, 2))
        values[:, [CONIC_A, CONIC_C, OPACITY, RED]] = 0.001, 0.001, 0.01, 1
        drawn = torch.tensor(values, requires_grad=True)
        everyone = torch.arange(count).repeat(tiles)
        lengths = torch.full((tiles,), count)
        lists = TensorLists(torch.arange(tiles + 1) * count, everyone, 10, lengths, lengths)
        peaks.append(
            peak_bytes(lambda d=drawn, t=lists: torch.autograd.backward(  # type: ignore[misc]
                blend(d, t, batch_bytes).sum()
            ))
        )  # fmt: skip
    pictures = 4 * 4 * 3 * 256 * tiles
    assert peaks[1] < batch_bytes + pictures
    assert peaks[1] < 1.2 * peaks[0]
    # The bound is not far too large.
    assert peaks[1] > batch_bytes / 2


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
    with pytest.raises(InvalidError, match=r"^device cuda:1 has 1\.00 GB free.*--num-gs") as caught:
        planned(GPU, 10**9, 512 << 20, 4 << 30, "device cuda:1")
    assert "\n" not in str(caught.value)


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
    selection = Selection(every, every)
    resident.step(steps(1)[0], selection)
    peak = peak_bytes(lambda: resident.step(steps(1)[0], selection))
    assert peak < plan.step_bytes
    # The plan is not far too large either, apart from the batches that it allows.
    assert peak > 0.15 * (plan.step_bytes - (16 << 20))
