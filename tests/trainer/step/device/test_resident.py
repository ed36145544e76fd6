"""A training on a device matches one in host arrays, and its steps copy only numbers."""

from __future__ import annotations

import ast
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

import trainer.step.device
from codec.arrays import Ints
from codec.camera import Camera
from tests.support.reference_render import turned_camera
from trainer.capture.capture import Mask
from trainer.pictures.scale import Shot
from trainer.step.backend import Resident, Selection, Step, Training
from trainer.step.colour import CameraColour
from trainer.step.cpubackend import CpuBackend
from trainer.step.device.backends import CudaBackend, TorchBackend
from trainer.step.device.tensors import Crossing, PictureCache, pack
from trainer.step.device.tensorstep import add_tensor_noise
from trainer.step.optimiser import (
    GATE_STEEPNESS,
    Adam,
    AgeScaling,
    CameraSpread,
    OptimiserConfig,
    add_noise,
)
from trainer.step.raster import Parameters, View

NUM_GS = 300
SHOWN = np.concatenate([np.arange(20, NUM_GS), NUM_GS + np.arange(10, 60)]).astype(np.int32)
TRAINED = np.arange(40, NUM_GS, dtype=np.int32)
"""Rows that are trained; the others below NUM_GS follow another training."""
WEIGHTS = (0.2, 0.01, 0.02)
NEAR_M = 0.2
CAMERAS, FRAMES = 3, 2


class Pictures:
    """Pictures of noise; those of the second camera have masks."""

    num_frames = FRAMES

    def __init__(self, times: int) -> None:
        camera = turned_camera()
        camera = camera.resized(times * camera.width_px, times * camera.height_px)
        aside = np.zeros((4, 4))
        aside[0, 3] = 0.3
        self.cameras: list[Camera] = [
            replace(camera, name=f"{i}", w2c=camera.w2c + i * aside) for i in range(CAMERAS)
        ]
        self.asked: list[tuple[int, int]] = []

    def shot(self, camera: int, frame: int) -> Shot:
        self.asked.append((camera, frame))
        rng = np.random.default_rng(10 * camera + frame)
        size = self.cameras[0].height_px, self.cameras[0].width_px
        shade = rng.integers(0, 256, (*size, 3), dtype=np.uint8)
        return Shot(shade // 4 + np.uint8(60), self.mask(camera, frame))

    def mask(self, camera: int, frame: int) -> Mask | None:
        size = self.cameras[0].height_px, self.cameras[0].width_px
        return (np.random.default_rng(5).random(size) > 0.2).astype(np.uint8) if camera else None


def training(sh_degree: int, age_scaling: AgeScaling = "update", times: int = 1) -> Training:
    """A training with random Gaussians. times: scale of the pictures."""
    rng, pictures = np.random.default_rng(2), Pictures(times)
    values = Parameters.zeros(2 * NUM_GS, sh_degree)
    values.means[:] = rng.uniform(-1, 1, (2 * NUM_GS, 3))
    values.log_scales[:] = rng.normal(-2.3, 0.3, (2 * NUM_GS, 3))
    values.quats[:] = rng.normal(size=(2 * NUM_GS, 4))
    values.logit_opacities[:] = rng.normal(-1, 2, 2 * NUM_GS)
    values.sh[:] = 0.2 * rng.normal(size=values.sh.shape)
    adam = Adam(NUM_GS, sh_degree, OptimiserConfig(age_scaling=age_scaling))
    views = [View.prepare(c, NEAR_M) for c in pictures.cameras]
    halves = [View.prepare(c.halved(), NEAR_M) for c in pictures.cameras]
    colour = CameraColour(CAMERAS, 1e-3)
    spread = CameraSpread.of(pictures.cameras)
    return Training(values, adam, colour, pictures, views, halves, spread, 0.005)


def started(on_torch: bool, given: Training) -> Resident:
    """On the CPU's backend, or on plain torch."""
    backend = TorchBackend(*WEIGHTS, "cpu") if on_torch else CpuBackend(*WEIGHTS)
    resident: Resident = backend.start(given)
    return resident


def assert_alike(theirs: Training, ours: Training, share: float) -> None:
    """Asserts that all arrays agree, up to a share of the largest number of each."""
    for (name, a), b in zip(arrays_of(theirs).items(), arrays_of(ours).values(), strict=True):
        np.testing.assert_allclose(a, b, rtol=0, atol=share * np.abs(b).max(), err_msg=name)


def begin(resident: Resident) -> None:
    ages = (np.arange(NUM_GS) % 4).astype(np.float32)
    cells = [(np.arange(NUM_GS) // size).astype(np.int32) for size in (7, 2)]
    resident.begin_window(ages, cells)


def steps(count: int, first: int = 0) -> list[Step]:
    """Steps over all cameras and frames; a quarter uses half size, a third moves cells together."""
    return [
        Step(
            i % CAMERAS, i // CAMERAS % FRAMES, is_half=i % 4 == 3, whole=True, means_lr_m=1e-3,
            calm=1.0 if i < 40 else 0.7, noise_m=50.0, seed=1_000_003 * 7 + i,
            level=i % 2 if i % 3 == 2 else None,
        )
        for i in range(first, first + count)
    ]  # fmt: skip


def run(resident: Resident, some: list[Step]) -> list[float]:
    selection = Selection(SHOWN, TRAINED)
    for i, step in enumerate(some):
        resident.step(step, selection)
        if i % 10 == 9:
            resident.bound_scales(selection, 0.05)
    return resident.losses(wait=True)


def arrays_of(given: Training) -> dict[str, np.ndarray[Any, Any]]:
    adam = given.adam
    named: dict[str, np.ndarray[Any, Any]] = {"steps": adam.steps, **given.colour.state()}
    for name, parameters in (("", given.values), ("first ", adam.first), ("second ", adam.second)):
        for slot, array in zip(Parameters.__slots__, parameters.arrays, strict=True):
            named[name + slot] = array
    return named


@pytest.mark.parametrize("sh_degree", [0, 1, 2, 3])
def test_fifty_steps_lead_to_the_same_gaussians(sh_degree: int) -> None:
    age_scaling: AgeScaling = ("update", "gradient", "off", "update")[sh_degree]
    ours, theirs = (training(sh_degree, age_scaling) for _ in range(2))
    before = ours.values.means.copy()
    losses = []
    for given in (ours, theirs):
        resident = started(given is theirs, given)
        begin(resident)
        losses.append(run(resident, steps(50)))
        resident.fetch(history=True)
    np.testing.assert_allclose(losses[1], losses[0], rtol=2e-4)
    assert len(losses[0]) == 50
    moved = np.abs(ours.values.means - before).max(axis=1)
    assert (moved[TRAINED] > 0).all()
    assert (np.delete(moved, TRAINED) == 0).all()
    assert_alike(theirs, ours, 3e-3)


@pytest.mark.parametrize("is_half", [False, True])
def test_where_few_are_trained_only_their_tiles_are_compared(is_half: bool) -> None:
    """Losses equal those of numba, which skips the other tiles, too; colours do not change."""
    ours, theirs = (training(1, times=4) for _ in range(2))
    losses, few = [], TRAINED[:6]
    some = [replace(step, whole=False, is_half=is_half) for step in steps(30)]
    for given in (ours, theirs):
        resident = started(given is theirs, given)
        given.values.means[few] *= np.float32(0.2)
        given.values.log_scales[few] = -4
        resident.send(few)
        begin(resident)
        # The rows that numba treats as trained are all below NUM_GS.
        rows = np.concatenate([few, SHOWN[SHOWN >= NUM_GS]]).astype(np.int32)
        selection = Selection(rows, few)
        for step in some:
            resident.step(step, selection)
        losses.append(resident.losses(wait=True))
        resident.fetch(history=True)
    np.testing.assert_allclose(losses[1], losses[0], rtol=1e-3)
    assert losses[0][0] < 0.15  # the loss of a whole picture is over 0.3
    assert_alike(theirs, ours, 1e-2)
    assert (theirs.colour.values[:, :3] == 1).all()


@pytest.mark.parametrize("whole", [False, True])
@pytest.mark.parametrize("rows", [SHOWN, SHOWN[:0]], ids=["none trained", "none shown"])
def test_where_nothing_is_trained_nothing_moves(rows: Ints, whole: bool) -> None:
    losses = []
    for on_torch in (False, True):
        given = training(1)
        before = [array.copy() for array in given.values.arrays]
        shown = rows[rows >= NUM_GS]
        resident = started(on_torch, given)
        begin(resident)
        selection = Selection(shown, SHOWN[:0])
        for step in steps(6):
            resident.step(replace(step, whole=whole), selection)
        resident.bound_scales(selection, 0.05)
        losses.append(resident.losses(wait=True))
        resident.fetch(history=True)
        for array, was in zip(given.values.arrays, before, strict=True):
            assert np.array_equal(array, was)
        assert not given.adam.steps.any()
    assert losses[1] == pytest.approx(losses[0], rel=1e-3, abs=1e-9)


def test_pictures_keep_to_their_bound_and_come_again() -> None:
    given = training(0)
    shot_bytes = 4 * given.views[0].camera.width_px * given.views[0].camera.height_px
    crossing = Crossing(torch.device("cpu"))
    cache = PictureCache(given.pictures, crossing, 2 * shot_bytes)
    for _ in range(2):
        for camera in range(CAMERAS):
            shot = given.pictures.shot(camera, 0)
            taken = cache.take(camera, 0)
            assert np.array_equal(taken.picture.numpy(), shot.picture)
            assert cache.held_bytes <= 2 * shot_bytes
            for is_half in (False, True):
                planes, counts = taken.planes(is_half)
                wanted = shot.half() if is_half else shot
                expected = np.empty((3, *wanted.shape), np.float32)
                wanted.fill(expected)
                np.testing.assert_allclose(planes.numpy(), expected, atol=1e-6)
                assert (counts is None) == (wanted.mask is None)
                if counts is not None and wanted.mask is not None:
                    assert np.array_equal(counts.numpy(), wanted.mask)
    assert crossing.picture_bytes == pytest.approx(6 * shot_bytes, rel=0.2)
    assert crossing.crossed_bytes == 0


def shape_only(**given: Any) -> tuple[torch.Tensor, torch.Tensor, dict[str, Any]]:
    """A picture of gsplat's size that depends on all arguments."""
    names = ("means", "quats", "scales", "opacities", "colors", "viewmats", "Ks")
    light = sum(given[name].sum() for name in names)
    drawn = {"means2d": given["means"][None, :, :2], "radii": given["means"][None, :, :2].int()}
    return light * light.new_ones(1, given["height"], given["width"], 3), light, drawn


def test_a_step_looks_at_no_value_on_the_device() -> None:
    """Tensors of the device `meta` have no values: reading one, or mixing in a tensor of the host,
    is an error."""
    given = training(3)
    resident = CudaBackend(*WEIGHTS, shape_only, "meta").start(given)
    begin(resident)
    selection = Selection(SHOWN, TRAINED)
    for step in steps(12):
        resident.step(replace(step, whole=step.seed % 2 == 0), selection)
        assert resident.losses(wait=False) == []
    resident.bound_scales(selection, 0.1)
    with pytest.raises(NotImplementedError, match="meta"):
        resident.losses(wait=True)
    # The rasteriser in plain torch fails here, because it reads the lengths of its lists.
    plain = TorchBackend(*WEIGHTS, "meta").start(given)
    with pytest.raises((NotImplementedError, RuntimeError)):
        plain.step(steps(1)[0], Selection(SHOWN, TRAINED))


CROSSES = {
    "item", "tolist", "cpu", "numpy", "to", "cuda", "from_numpy", "tensor", "as_tensor",
    "pin_memory", "synchronize",
}  # fmt: skip
"""Methods that copy values between host and device, or make the host wait."""


def test_arrays_cross_in_one_module_alone() -> None:
    folder = Path(trainer.step.device.__file__).parent
    found = {
        (file.stem, node.func.attr)
        for file in folder.glob("*.py")
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8")))
        if isinstance(node, ast.Call)
        and isinstance(node.func, ast.Attribute)
        and node.func.attr in CROSSES
    }
    assert ("tensors", "cpu") in found
    assert {stem for stem, _ in found} == {"tensors"}


@pytest.mark.parametrize("seed", [0, 5, 2**63 + 11, 2**64 - 1])
def test_the_noise_is_the_kernel_s_and_repeats(seed: int) -> None:
    rng, rows = np.random.default_rng(1), np.arange(50, 250, dtype=np.int32)
    values = Parameters.zeros(NUM_GS, 0)
    values.log_scales[:] = rng.normal(-1, 0.5, (NUM_GS, 3))
    values.quats[:] = rng.normal(size=(NUM_GS, 4))
    values.logit_opacities[:] = rng.uniform(-8, 0, NUM_GS)
    packed = [torch.from_numpy(pack(values, rows)) for _ in range(2)]
    there = torch.from_numpy(rows).long()
    for tensor in packed:
        add_tensor_noise(tensor, there, 0.7, 0.005, seed)
    assert torch.equal(*packed)
    add_noise(
        *values.arrays[:4], rows, np.float32(0.7), np.float32(0.005), np.float32(GATE_STEEPNESS),
        np.uint64(seed),
    )  # fmt: skip
    np.testing.assert_allclose(packed[0][:, :3].numpy(), values.means[rows], rtol=1e-4, atol=1e-6)
    assert np.abs(values.means[rows]).max() > 0.1


def test_the_host_s_changes_arrive_and_the_device_s_come_back() -> None:
    """The host rewrites, relocates or restarts rows between steps."""
    ours, theirs = training(1), training(1)
    for given in (ours, theirs):
        resident = started(given is theirs, given)
        begin(resident)
        run(resident, steps(5))
        resident.fetch(history=True)
        rows = np.array([50, 70, NUM_GS + 20])
        for array in given.values.arrays:
            array[rows] = array[[60, 61, 62]]
        given.adam.reset(rows[:2])
        resident.send(rows)
        run(resident, steps(5, 5))
        resident.fetch()  # without the history, which the rows below do not need
        given.values.means[:NUM_GS] += np.float32(0.01)
        given.adam.reset(np.arange(NUM_GS))
        resident.send(slice(NUM_GS))
        run(resident, steps(5, 10))
        resident.fetch(history=True)
    assert ours.adam.steps[TRAINED].tolist() == [5] * len(TRAINED)
    assert_alike(theirs, ours, 3e-3)


def test_on_a_gpu_a_step_does_not_wait() -> None:
    if not torch.cuda.is_available():
        pytest.skip("needs an NVIDIA GPU")
    given = training(3)
    resident = CudaBackend(*WEIGHTS, shape_only, "cuda").start(given)
    begin(resident)
    selection = Selection(SHOWN, TRAINED)
    for step in steps(CAMERAS * FRAMES):
        resident.step(step, selection)
    torch.cuda.set_sync_debug_mode("error")
    try:
        for step in steps(30):
            resident.step(step, selection)
    finally:
        torch.cuda.set_sync_debug_mode("default")
    assert len(resident.losses(wait=True)) == 36
