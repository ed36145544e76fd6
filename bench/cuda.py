"""Training on a GPU at the paper's scale: seconds per frame, quality and memory against the length,
by gsplat and by plain torch, in one go and in parts.

Usage: scripts/bench cuda CAPTURE [--frames 30 75 150] [--backends cuda torch] [--ray-workers 2]

Needs a GPU: an NVIDIA one and the extra `cuda`, or one that torch knows and `--backends torch`.
Preset paper, from the first frame on, scored from the decoded files; each training is in a process
of its own. With `--ray-workers`, and the extra `ray`, the longest is trained twice more with slots
that last a frame (swin_size 1), as parts need them: in one go, and in a part for
each of so many workers, which share the GPUs of this machine.
"""

from __future__ import annotations

import math
import resource
import sys
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Annotated, Literal

import tyro
from rich.console import Console
from rich.table import Table

from codec.console import run_command
from trainer.parts.raydriver import train_in_parts
from trainer.run.config import LOCAL, TrainConfig
from trainer.run.job import train_stream
from trainer.run.preset import PRESETS
from trainer.score.evaluate import EvaluateConfig, evaluate_stream

DeviceBackendName = Literal["cuda", "torch"]
How = Literal["slices", "slots", "parts"]
"""As the preset says; slots that last a frame; the same in parts."""
COLUMNS = (
    "backend", "how", "frames", "s/frame", "PSNR dB", "SSIM", "GPU GB", "host GB", "kB/frame",
)  # fmt: skip


@dataclass(frozen=True)
class CudaConfig:
    """Trains a capture on the GPU at several lengths, by each backend."""

    capture: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="CAPTURE")]
    """Folder of the capture."""
    frames: tuple[int, ...] = (30, 75, 150)
    """Lengths to train, in frames."""
    backends: tuple[DeviceBackendName, ...] = ("cuda", "torch")
    """Training backends: cuda (gsplat), torch (plain torch)."""
    ray_workers: int = 0
    """Ray workers that train the longest video in parallel; 0 for none."""
    worker_cpus: float = 4
    """Cores that each Ray worker claims."""
    torch_device: str | None = None
    """Device of backend torch, as in swings-train."""
    scale: float = 1.0
    """Scale of the training pictures relative to the capture."""
    num_gs: int = 200_000
    """Gaussians. Paper, section 8.1."""
    genesis_iterations: int = 30_000
    """Iterations of the first window. Paper, section 8.1."""
    window_iterations: int = 2_000
    """Iterations of every later window. Paper, section 8.1."""


@dataclass(frozen=True, slots=True)
class Measured:
    """One training."""

    backend: DeviceBackendName
    how: How
    frames: int
    s_per_frame: float
    psnr_db: float
    ssim: float
    device_bytes: int | None
    """The most that torch has held on the device; None where torch does not count it, and for
    parts, whose workers hold it."""
    host_bytes: int
    bytes_per_frame: float

    @property
    def texts(self) -> tuple[str, ...]:
        """In the order of COLUMNS."""
        on_device = "-" if self.device_bytes is None else f"{self.device_bytes / 1e9:.2f}"
        return (
            self.backend, self.how, str(self.frames), f"{self.s_per_frame:.1f}",
            f"{self.psnr_db:.2f}", f"{self.ssim:.3f}", on_device, f"{self.host_bytes / 1e9:.2f}",
            f"{self.bytes_per_frame / 1e3:.0f}",
        )  # fmt: skip


def training(
    config: CudaConfig, backend: DeviceBackendName, num_frames: int, stream: Path
) -> TrainConfig:
    """Preset paper on the first `num_frames` frames."""
    paper = PRESETS["paper"](
        config.capture, stream, frames=f"0:{num_frames}", scale=config.scale, backend=backend,
        torch_device=config.torch_device if backend == "torch" else None,
    )  # fmt: skip
    fit = replace(
        paper.fit,
        num_gs=config.num_gs,
        genesis_iterations=config.genesis_iterations,
        window_iterations=config.window_iterations,
    )
    return replace(paper, fit=fit)


def with_slots(job: TrainConfig) -> TrainConfig:
    """The same with slots that last a frame."""
    fit = replace(job.fit, swin_size=1)
    return replace(job, whole_slices=False, rank="contribution", fit=fit)


def in_parts(job: TrainConfig, config: CudaConfig, num_frames: int) -> TrainConfig:
    """The same in a part for each worker."""
    import torch

    part_frames = -(-num_frames // config.ray_workers)
    seam_frames = min(job.seam_frames, part_frames // 2)
    return replace(
        job,
        ray=LOCAL,
        part_frames=part_frames,
        seam_frames=seam_frames,
        segment_frames=math.gcd(part_frames, seam_frames),
        worker_cpus=config.worker_cpus,
        worker_gpus=torch.cuda.device_count() / config.ray_workers,
    )


def _device_peak_bytes() -> int | None:
    import torch

    if torch.cuda.is_available():
        return int(torch.cuda.max_memory_allocated())
    if torch.xpu.is_available():
        return int(torch.xpu.max_memory_allocated())
    return None


def measured(config: CudaConfig, backend: DeviceBackendName, how: How, num_frames: int) -> Measured:
    """Trains and scores; memory is of the whole process, in parts of the driver."""
    console = Console(stderr=True)
    with tempfile.TemporaryDirectory() as folder:
        stream = Path(folder) / "stream"
        job = training(config, backend, num_frames, stream)
        if how != "slices":
            job = with_slots(job)
        begin_s = time.monotonic()
        if how == "parts":
            train_in_parts(in_parts(job, config, num_frames), LOCAL, console)
        else:
            train_stream(job, console)
        took_s = time.monotonic() - begin_s
        unit_bytes = 1 if sys.platform == "darwin" else 1024
        host_bytes = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit_bytes
        score = evaluate_stream(EvaluateConfig(stream, config.capture)).layers[-1]
    device_bytes = None if how == "parts" else _device_peak_bytes()
    return Measured(
        backend, how, num_frames, took_s / num_frames, score.psnr_db, score.ssim, device_bytes,
        host_bytes, score.bytes_per_frame,
    )  # fmt: skip


def rows(config: CudaConfig) -> Iterator[Measured]:
    """Every length by every backend, each in a process of its own; then what is in parts."""
    wanted: list[tuple[DeviceBackendName, How, int]] = [
        (backend, "slices", num_frames)
        for num_frames in config.frames
        for backend in config.backends
    ]
    if config.ray_workers:
        longest = max(config.frames)
        for backend in config.backends:
            wanted += [(backend, "slots", longest), (backend, "parts", longest)]
    for each in wanted:
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as process:
            yield process.submit(measured, config, *each).result()


def run(config: CudaConfig) -> None:
    title = []
    for backend in config.backends:
        # To refuse a machine without one before anything is read.
        job = training(config, backend, 1, Path("stream"))
        title.append(job.fit.backend(backend, job.torch_device).why)
    table = Table(title=f"{'; '.join(title)}: {config.num_gs:,} Gaussians")
    for name in COLUMNS:
        table.add_column(name, justify="right")
    for row in rows(config):
        table.add_row(*row.texts)
    Console().print(table)


if __name__ == "__main__":
    run_command(CudaConfig, run, "scripts/bench cuda", "Trains on a GPU at the paper's scale.")
