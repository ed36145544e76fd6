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


def training(config: CudaConfig, num_frames: int, stream: Path) -> TrainConfig:
    """Preset paper on the first `num_frames` frames."""
    paper = PRESETS["paper"](
        config.capture, stream, frames=f"0:{num_frames}", scale=config.scale, backend="cuda"
    )
    fit = replace(
        paper.fit,
        genesis_iterations=config.genesis_iterations,
        window_iterations=config.window_iterations,
    )
    return replace(paper, fit=fit)


def run(config: CudaConfig) -> None:
    fit = training(config, 1, Path("stream")).fit
    fit.backend("cuda")  # to refuse a machine without one before anything is read
    import torch

    console = Console(stderr=True)
    table = Table(title=f"{torch.cuda.get_device_name()}: {fit.num_gs:,} Gaussians")
    for name in ("frames", "s/frame", "GPU GB", "host GB", "PSNR dB", "SSIM", "kB/frame"):
        table.add_column(name, justify="right")
    for length in config.frames:
        torch.cuda.reset_peak_memory_stats()
        with tempfile.TemporaryDirectory() as folder:
            stream = Path(folder) / "stream"
            begin_s = time.monotonic()
            train_stream(training(config, length, stream), console)
            took_s = time.monotonic() - begin_s
            score = evaluate_stream(EvaluateConfig(stream, config.capture)).layers[-1]
        table.add_row(
            str(length),
            f"{took_s / length:.1f}",
            f"{torch.cuda.max_memory_allocated() / 1e9:.2f}",
            f"{resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e9:.2f}",
            f"{score.psnr_db:.2f}",
            f"{score.ssim:.3f}",
            f"{score.bytes_per_frame / 1e3:.0f}",
        )
    Console().print(table)


if __name__ == "__main__":
    run_command(CudaConfig, run, "scripts/bench cuda", "Trains on a GPU at the paper's scale.")
