"""Training steps of the GPU benchmark: steps per second, bytes copied to and from the device, and
the bare training step of the same rasteriser as the bound.

The bare step is that of gsplat's examples: rasterise, L1 and SSIM, torch's Adam over every row. It
has no age per row, noise, relocation, leases, masks or camera colours.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal

import numpy as np
import torch
from torch import Tensor

from bench.train import DSSIM_WEIGHT, MEANS_LR_M, NEAR_M, bench_camera, bench_shot, scene
from trainer.capture.capture import Mask
from trainer.fit.config import FitConfig
from trainer.pictures.scale import Shot
from trainer.step.backend import Selection, Step, Training
from trainer.step.colour import CameraColour
from trainer.step.device.device import DeviceBackend
from trainer.step.device.tensors import DeviceView
from trainer.step.device.tensorstep import dissimilarity_map, seen_colours
from trainer.step.device.torchrender import Solids
from trainer.step.loss import TAPS
from trainer.step.optimiser import (
    LOG_SCALES_LR,
    LOGIT_OPACITIES_LR,
    QUATS_LR,
    SH_LR,
    Adam,
    CameraSpread,
    OptimiserConfig,
)
from trainer.step.raster import Parameters, View

DeviceBackendName = Literal["cuda", "torch"]
STEP_COLUMNS = (
    "backend", "Gaussians", "size", "ms/step", "steps/s", "bytes/step", "bare ms", "of bare",
    "device MB",
)  # fmt: skip
CAMERAS = 4
WARM_STEPS = 4


@dataclass(frozen=True, slots=True)
class StepCase:
    """A step to measure."""

    backend: DeviceBackendName
    torch_device: str | None
    count: int
    """Number of Gaussians; all are trained."""
    width_px: int
    height_px: int
    steps: int
    """Number of timed steps."""


@dataclass(frozen=True, slots=True)
class StepRow:
    """Time, bytes and memory of a step."""

    case: StepCase
    ms: float
    crossed_bytes: float
    """Bytes per step, without the pictures, which are already on the device."""
    bare_ms: float
    device_bytes: int | None

    @property
    def texts(self) -> tuple[str, ...]:
        """The cells of the row, in the order of STEP_COLUMNS."""
        case = self.case
        held = "-" if self.device_bytes is None else f"{self.device_bytes / 1e6:.0f}"
        return (
            case.backend, f"{case.count:,}", f"{case.width_px}x{case.height_px}", f"{self.ms:.2f}",
            f"{1e3 / self.ms:.1f}", f"{self.crossed_bytes:.0f}", f"{self.bare_ms:.2f}",
            f"{self.ms / self.bare_ms:.2f}", held,
        )  # fmt: skip


class BenchPictures:
    """Pictures of the same noise for every camera."""

    num_frames = 1

    def __init__(self, width_px: int, height_px: int) -> None:
        self.cameras = [bench_camera(width_px, height_px) for _ in range(CAMERAS)]
        self._shot = bench_shot(width_px, height_px)

    def shot(self, camera: int, frame: int) -> Shot:
        return self._shot

    def mask(self, camera: int, frame: int) -> Mask | None:
        return None


def bench_training(case: StepCase) -> Training:
    """A training whose rows are those of `bench.train.scene`, twice."""
    pictures, values = BenchPictures(case.width_px, case.height_px), scene(case.count)
    both = Parameters.zeros_like(values, 2 * case.count)
    for array, given in zip(both.arrays, values.arrays, strict=True):
        array[: case.count] = array[case.count :] = given
    views = [View.prepare(camera, NEAR_M) for camera in pictures.cameras]
    adam = Adam(case.count, 0, OptimiserConfig())
    colour, spread = CameraColour(CAMERAS, 1e-3), CameraSpread.of(pictures.cameras)
    return Training(both, adam, colour, pictures, views, [], spread, 0.005)


def _seconds(step: Callable[[int], Any], wait: Callable[[], Any], count: int) -> float:
    """Mean seconds per step, after a wait for the device to finish `count` steps."""
    for i in range(WARM_STEPS):
        step(i)
    wait()
    begin = time.perf_counter()
    for i in range(count):
        step(i)
    wait()
    return (time.perf_counter() - begin) / count


def _gsplat_bare(parts: list[Tensor], view: DeviceView) -> Tensor:
    from gsplat import rasterization

    means, log_scales, quats, logits, sh = parts
    pictures, _, _ = rasterization(
        means=means, quats=quats, scales=log_scales.exp(), opacities=torch.sigmoid(logits),
        colors=sh, sh_degree=0, viewmats=view.w2c[None], Ks=view.intrinsics[None],
        width=view.camera.width_px, height=view.camera.height_px, near_plane=view.near_m,
        packed=False,
    )  # fmt: skip
    picture: Tensor = pictures[0].permute(2, 0, 1)
    return picture


def _plain_bare(parts: list[Tensor], view: DeviceView, backend: DeviceBackend) -> Tensor:
    means, log_scales, quats, logits, sh = parts
    solids = Solids(
        means, torch.nn.functional.normalize(quats, dim=1), log_scales.exp(),
        torch.sigmoid(logits), seen_colours(means, sh, view.position),
    )  # fmt: skip
    return backend.loss.rasterise(solids, view, len(means), True).picture


def bare_step_s(case: StepCase, backend: DeviceBackend) -> float:
    """Seconds of a bare step."""
    training, crossing = bench_training(case), backend.crossing
    parts = [
        crossing.send(array[: case.count]).requires_grad_() for array in training.values.arrays
    ]
    groups = zip(
        parts,
        (MEANS_LR_M, LOG_SCALES_LR, QUATS_LR, LOGIT_OPACITIES_LR, SH_LR),
        strict=True,
    )
    optimiser = torch.optim.Adam(
        [{"params": [part], "lr": lr} for part, lr in groups], eps=OptimiserConfig().eps, fused=True
    )
    view, taps = DeviceView.send(training.views[0], crossing), crossing.send(TAPS)
    pixels = crossing.send_picture(training.pictures.shot(0, 0).picture)
    target = pixels.permute(2, 0, 1).float() / 255
    draw = _gsplat_bare if case.backend == "cuda" else partial(_plain_bare, backend=backend)
    losses: list[Tensor] = []

    def step(_: int) -> None:
        picture = draw(parts, view)
        l1 = (picture - target).abs().mean()
        loss = (1 - DSSIM_WEIGHT) * l1
        loss = loss + DSSIM_WEIGHT * dissimilarity_map(picture, target, taps).mean()
        loss.backward()  # type: ignore[no-untyped-call]
        optimiser.step()
        optimiser.zero_grad(set_to_none=True)
        losses[:] = [loss.detach()]

    return _seconds(step, lambda: float(losses[0]), case.steps)


def device_peak_bytes() -> int | None:
    """Peak memory that torch allocated on the device; None where torch does not count it."""
    if torch.cuda.is_available():
        return int(torch.cuda.max_memory_allocated())
    if torch.xpu.is_available():
        return int(torch.xpu.max_memory_allocated())
    return None


def measured_step(case: StepCase) -> StepRow:
    """Times steps of a resident, then bare steps. It needs a new process: the memory is a peak."""
    device = case.torch_device if case.backend == "torch" else None
    backend = FitConfig().backend(case.backend, device).backend
    assert isinstance(backend, DeviceBackend)
    resident = backend.start(bench_training(case))
    resident.begin_window(np.zeros(case.count, np.float32), [])
    rows = np.arange(case.count, dtype=np.int32)
    selection = Selection(rows, rows)

    def step(i: int) -> None:
        given = Step(i % CAMERAS, 0, False, True, MEANS_LR_M, 1.0, 1e-9, i)
        resident.step(given, selection)

    for i in range(CAMERAS):  # sends the pictures
        step(i)
    resident.losses(wait=True)
    before, taken = backend.crossing.crossed_bytes, case.steps + WARM_STEPS
    step_s = _seconds(step, lambda: resident.losses(wait=True), case.steps)
    crossed = (backend.crossing.crossed_bytes - before) / taken
    device_bytes = device_peak_bytes()
    bare_s = bare_step_s(case, backend)
    return StepRow(case, 1e3 * step_s, crossed, 1e3 * bare_s, device_bytes)
