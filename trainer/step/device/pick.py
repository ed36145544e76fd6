"""Which backend computes, and why: the one that is named, or the best that works."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from textwrap import shorten

import numpy as np

from codec.camera import Camera
from codec.errors import InvalidError
from trainer.pictures.scale import Shot
from trainer.step.backend import Backend, BackendName, Selection, Step, StepInput, Training
from trainer.step.colour import CameraColour
from trainer.step.cpubackend import CpuBackend
from trainer.step.optimiser import Adam, CameraSpread, OptimiserConfig
from trainer.step.raster import Parameters, View

TOLERANCE = 1e-3
"""Tolerated error of a trial's loss: far above rounding, far below a device that errs."""

MAX_REASON = 160
"""Largest part of a foreign error that a message quotes, characters."""


@dataclass(frozen=True, slots=True)
class Weights:
    """Weights of the loss, which every backend is made with."""

    dssim: float
    opacity_reg: float
    scale_reg: float


@dataclass(frozen=True, slots=True)
class Picked:
    """A backend that works here."""

    backend: Backend
    why: str
    """Its name and device and, where it was not named, why this one: one line."""


def _accelerator() -> str | None:
    """The best device of torch that is there and is not a CPU."""
    import torch

    has_xpu, has_mps = torch.xpu.is_available(), torch.backends.mps.is_available()
    there = (("cuda", torch.cuda.is_available()), ("xpu", has_xpu), ("mps", has_mps))
    return next((name for name, is_there in there if is_there), None)


def _cuda_lacks() -> str | None:
    """The first requirement of `--backend cuda` that is missing here, if any."""
    if find_spec("torch") is None:
        return "torch is not installed"
    import torch

    if not torch.cuda.is_available():
        return "torch sees no NVIDIA GPU"
    return "gsplat is not installed" if find_spec("gsplat") is None else None


def _cuda(weights: Weights) -> Backend:
    from gsplat import rasterization

    from .backends import CudaBackend

    return CudaBackend(weights.dssim, weights.opacity_reg, weights.scale_reg, rasterization)


def _plain(weights: Weights, device: str) -> Backend:
    from .backends import TorchBackend

    return TorchBackend(weights.dssim, weights.opacity_reg, weights.scale_reg, device)


def _numba(weights: Weights) -> Backend:
    return CpuBackend(weights.dssim, weights.opacity_reg, weights.scale_reg)


_CAMERA = Camera("trial", 40, 24, 30.0, 30.0, 20.0, 12.0, np.eye(4))
_SHOT = Shot(np.full((24, 40, 3), 90, np.uint8))


def _trial_gaussians() -> Parameters:
    values = Parameters.zeros(3, 0)
    values.means[:] = np.array([[0, 0, 2], [0.3, 0.2, 3], [-0.2, 0.1, 2.5]])
    values.log_scales[:] = -1.5
    values.quats[:, 0] = 1
    values.sh[:] = 1
    return values


def _trial_loss(backend: Backend) -> float:
    """Loss of a step on three Gaussians; NaN if a gradient is no number."""
    rows, view = np.arange(3, dtype=np.int32), View.prepare(_CAMERA, 0.2)
    gain, bias = np.ones(3, np.float32), np.zeros(3, np.float32)
    gradients = Parameters.zeros(3, 0)
    given = StepInput(_trial_gaussians(), rows, view, _SHOT, gain, bias, 3)
    loss = backend.step(given, gradients)
    return loss.value if all(np.isfinite(g).all() for g in gradients.arrays) else float("nan")


class _OneShot:
    """The picture of the trial."""

    num_frames = 1
    cameras = (_CAMERA,)

    def shot(self, camera: int, frame: int) -> Shot:
        return _SHOT

    def mask(self, camera: int, frame: int) -> None:
        return None


def _resident_loss(backend: Backend) -> float:
    """The same of a training that stays on the device, whose updates it makes; NaN if they give
    what is no number."""
    values, rows = Parameters.zeros(6, 0), np.arange(3, dtype=np.int32)
    for array, given in zip(values.arrays, _trial_gaussians().arrays, strict=True):
        array[:3] = array[3:] = given
    adam, colour = Adam(3, 0, OptimiserConfig()), CameraColour(1, 1e-3)
    view, spread = View.prepare(_CAMERA, 0.2), CameraSpread.of([_CAMERA])
    training = Training(values, adam, colour, _OneShot(), [view], [], spread, 0.005)
    resident = backend.start(training)
    resident.begin_window(np.zeros(3, np.float32), [np.zeros(3, np.int32)])
    resident.step(Step(0, 0, False, True, 1e-3, 1.0, 1.0, 1, 0), Selection(rows, rows))
    (loss,) = resident.losses(wait=True)
    before = values.means[:3].copy()
    resident.fetch(history=True)
    moved = (values.means[:3] != before).any() and (adam.steps == 1).all()
    arrays = (*values.arrays, *adam.first.arrays, *adam.second.arrays, colour.values)
    return loss if moved and all(np.isfinite(a).all() for a in arrays) else float("nan")


def tried(make: Callable[[], Backend], weights: Weights) -> Backend | str:
    """The backend of `make`; or why a step of it does not give the loss that plain torch gives on a
    CPU."""
    try:
        backend = make()
        losses = _trial_loss(backend), _resident_loss(backend)
    except (AttributeError, ImportError, OSError, RuntimeError) as error:
        # Kernels that do not compile or load, operations that a device lacks, memory.
        return _in_short(error)
    expected = _trial_loss(_plain(weights, "cpu"))
    for found in losses:
        if not abs(found - expected) <= TOLERANCE * expected:
            return f"its loss in a trial is {found:g}, not {expected:g}"
    return backend


def _in_short(error: Exception) -> str:
    """One line: torch adds every device that it was built for."""
    line = str(error).strip().partition("\n")[0] or type(error).__name__
    return shorten(line, MAX_REASON, placeholder=" ...")


def _torch_device(name: str | None) -> str:
    """The device `name`, by default the best. Raises InvalidError where torch has none such."""
    if find_spec("torch") is None:
        raise InvalidError("--backend torch: torch is not installed: pip install '.[torch]'")
    import torch

    if name is None:
        return _accelerator() or "cpu"
    try:
        torch.zeros(1, device=name)
    except (AssertionError, RuntimeError) as error:
        raise InvalidError(
            f"--torch-device {name}: torch cannot use it here: {_in_short(error)}"
        ) from error
    return name


def _described(device: str) -> str:
    import torch

    if device.startswith("cuda"):
        return f"{device} ({torch.cuda.get_device_name(device)})"
    if device.startswith("xpu"):
        return f"{device} ({torch.xpu.get_device_name(device)})"
    return device


def _named(name: BackendName, weights: Weights, device: str | None) -> Picked:
    if name == "cpu":
        return Picked(_numba(weights), "cpu (numba)")
    if name == "cuda":
        lacks = _cuda_lacks()
        if lacks is not None:
            raise InvalidError(
                f"--backend cuda: {lacks}; it needs an NVIDIA GPU, torch with CUDA and gsplat: "
                "pip install '.[cuda]'"
            )
        backend, where = tried(lambda: _cuda(weights), weights), "cuda (gsplat)"
    else:
        found = _torch_device(device)
        backend = tried(lambda: _plain(weights, found), weights)
        where = f"torch on {_described(found)}"
    if isinstance(backend, str):
        raise InvalidError(f"--backend {name}: {where} does not work here: {backend}")
    return Picked(backend, where)


def _best(weights: Weights) -> Picked:
    """gsplat, then torch on an accelerator, then numba; torch on a CPU is slower than numba."""
    cuda: Backend | str = _cuda_lacks() or tried(lambda: _cuda(weights), weights)
    if not isinstance(cuda, str):
        return Picked(cuda, "cuda (gsplat), the best")
    without = f"without cuda ({cuda})"
    if find_spec("torch") is None:
        return Picked(_numba(weights), f"cpu (numba), the best {without}")
    device = _accelerator()
    plain: Backend | str = "no GPU"
    if device is not None:
        plain = tried(lambda: _plain(weights, device), weights)
        if not isinstance(plain, str):
            return Picked(plain, f"torch on {_described(device)}, the best {without}")
    return Picked(_numba(weights), f"cpu (numba), the best {without} and torch ({plain})")


def pick_backend(name: BackendName, weights: Weights, device: str | None = None) -> Picked:
    """The backend `name`; auto is the best that works here.

    device: of backend torch, in torch's words; by default the best that is there. Raises
    InvalidError when what is asked for is missing or a step with it fails.
    """
    if device is not None and name != "torch":
        raise InvalidError(f"--torch-device {device} is for --backend torch, not {name}")
    return _best(weights) if name == "auto" else _named(name, weights, device)
