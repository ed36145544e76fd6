"""Training on a GPU at the paper's scale: seconds per frame and memory against the length.

Usage: scripts/bench cuda CAPTURE [--frames 30 75 150]

Needs an NVIDIA GPU and the extra `cuda`. Preset paper, from the first frame on, scored from the
decoded files.
"""

from __future__ import annotations

import resource
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console
from rich.table import Table

from codec.console import run_command
from trainer.fit.config import FitConfig
from trainer.run.config import TrainConfig
from trainer.run.job import train_stream
from trainer.run.preset import PRESETS
from trainer.score.evaluate import EvaluateConfig, evaluate_stream


@dataclass(frozen=True)
class CudaConfig:
    """Trains a capture on the GPU at several lengths."""

    capture: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="CAPTURE")]
    """Folder of the capture."""
    frames: tuple[int, ...] = (30, 75, 150)
    """Lengths to train."""
    scale: float = 1.0
    """Size of the training pictures over the capture's."""
    genesis_iterations: int = 30_000
    """Iterations of the first window. Paper, section 8.1."""
    window_iterations: int = 2_000
    """Iterations of every later window. Paper, section 8.1."""


def run(config: CudaConfig) -> None:
    paper = dict(PRESETS["paper"])
    base: FitConfig = paper.pop("fit")
    fit = replace(
        base,
        genesis_iterations=config.genesis_iterations,
        window_iterations=config.window_iterations,
    )
    fit.backend("cuda")  # to refuse a machine without one before anything is read
    import torch

    console = Console(stderr=True)
    table = Table(title=f"{torch.cuda.get_device_name()}: {fit.num_gs:,} Gaussians")
    for name in ("frames", "s/frame", "GPU GB", "host GB", "PSNR dB", "SSIM", "kB/frame"):
        table.add_column(name, justify="right")
    for length in config.frames:
        torch.cuda.reset_peak_memory_stats()
        with tempfile.TemporaryDirectory() as folder:
            job = TrainConfig(
                config.capture, Path(folder) / "stream", frames=f"0:{length}", backend="cuda",
                scale=config.scale, fit=fit, **paper,
            )  # fmt: skip
            begin_s = time.monotonic()
            train_stream(job, console)
            took_s = time.monotonic() - begin_s
            score = evaluate_stream(EvaluateConfig(job.target, config.capture)).layers[-1]
        table.add_row(
            str(length),
            f"{took_s / length:.1f}",
            f"{torch.cuda.max_memory_allocated() / 1e9:.2f}",
            f"{resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6:.2f}",
            f"{score.psnr_db:.2f}",
            f"{score.ssim:.3f}",
            f"{score.bytes_per_frame / 1e3:.0f}",
        )
    Console().print(table)


if __name__ == "__main__":
    run_command(CudaConfig, run, "scripts/bench cuda", "Trains on a GPU at the paper's scale.")
