"""Training on a GPU, in two tables. The first has steps per second and bytes copied to and from the
device at several numbers of Gaussians, beside the bare step of the same rasteriser; the second has
seconds per frame, quality and memory of whole trainings.

Usage: scripts/bench cuda [CAPTURE ...] [--backends cuda torch] [--ray-workers 2]

Needs a GPU: an NVIDIA GPU and the extra `cuda`, or any device of torch and `--backends torch`;
`--torch-device cpu` with small numbers checks that the bench works. Generates and trains the demo's
capture, then trains the given captures, with preset gpu or paper at --longest-px, and scores the
decoded files; each training runs in a process of its own. With `--ray-workers` and the extra `ray`,
the longest video is trained twice more with slots that last a frame (swin_size 1), as parts need
them: in one go, and in one part per worker; the workers share the GPUs of this machine.
"""

from __future__ import annotations

import math
import resource
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Annotated, Literal, TypeVar

import tyro
from rich.console import Console
from rich.table import Table

from bench.gpusteps import (
    STEP_COLUMNS,
    DeviceBackendName,
    StepCase,
    StepRow,
    device_peak_bytes,
    measured_step,
)
from codec.console import run_command
from trainer.capture.layout import open_capture
from trainer.fit.observer import Observer
from trainer.parts.raydriver import train_in_parts
from trainer.run.config import LOCAL, PRESETS, TrainConfig
from trainer.run.job import train_stream
from trainer.score.evaluate import EvaluateConfig, evaluate_stream
from trainer.synth.film import SynthConfig, synthesise

Row = TypeVar("Row")

How = Literal["preset", "slots", "parts"]
"""The preset unchanged; slots that last a frame; the same in parts."""
COLUMNS = (
    "capture", "backend", "how", "frames", "s/frame", "later s", "PSNR dB", "SSIM", "GPU GB",
    "host GB", "kB/frame",
)  # fmt: skip


@dataclass(frozen=True)
class CudaConfig:
    """Times steps on the GPU, and trains captures at several lengths, with each backend."""

    captures: Annotated[
        tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="CAPTURE")
    ] = ()
    """Folders of captures to train, besides the demo's capture."""
    demo: bool = True
    """Generate the demo's capture and train it, too."""
    frames: tuple[int, ...] = (30,)
    """Lengths to train, in frames."""
    backends: tuple[DeviceBackendName, ...] = ("cuda", "torch")
    """Training backends: cuda (gsplat), torch (plain torch)."""
    sizes: tuple[int, ...] = (20_000, 200_000, 1_000_000)
    """Numbers of Gaussians in the timed steps."""
    width_px: int = 1352
    """Width of the pictures in the timed steps, pixels."""
    height_px: int = 1014
    """Height of the pictures in the timed steps, pixels."""
    steps: int = 100
    """Number of timed steps."""
    preset: Literal["gpu", "paper"] = "gpu"
    """Preset of the trainings."""
    longest_px: int = 640
    """Longest side of the pictures of the trainings, pixels."""
    fps: float = 30.0
    """Frames per second of captures that do not state theirs."""
    ray_workers: int = 0
    """Ray workers that train the longest video in parallel; 0 for none."""
    worker_cpus: float = 4
    """Cores that each Ray worker claims."""
    torch_device: str | None = None
    """Device of backend torch, as in swings-train."""
    num_gs: int | None = None
    """Gaussians of the trainings; the preset's number by default."""
    genesis_iterations: int | None = None
    """Iterations of the first window, before it settles; the preset's number by default."""
    settle_rounds: int | None = None
    """Settling rounds of the first window; the preset's number by default."""
    window_iterations: int | None = None
    """Iterations of every later window; the preset's number by default."""


@dataclass(frozen=True, slots=True)
class Measured:
    """One training."""

    capture: str
    backend: DeviceBackendName
    how: How
    frames: int
    s_per_frame: float
    later_s_per_frame: float | None
    """Seconds per frame after the first, whose window takes long; None for parts."""
    psnr_db: float
    ssim: float
    device_bytes: int | None
    """Peak memory that torch allocated on the device; None where torch does not count it, and for
    parts, whose workers allocate it."""
    host_bytes: int
    bytes_per_frame: float

    @property
    def texts(self) -> tuple[str, ...]:
        """The cells of the row, in the order of COLUMNS."""
        on_device = "-" if self.device_bytes is None else f"{self.device_bytes / 1e9:.2f}"
        later = "-" if self.later_s_per_frame is None else f"{self.later_s_per_frame:.2f}"
        return (
            self.capture, self.backend, self.how, str(self.frames), f"{self.s_per_frame:.2f}",
            later, f"{self.psnr_db:.2f}", f"{self.ssim:.3f}", on_device,
            f"{self.host_bytes / 1e9:.2f}", f"{self.bytes_per_frame / 1e3:.0f}",
        )  # fmt: skip


class WindowTimes(Observer):
    """Records when each window ended."""

    def __init__(self) -> None:
        self._ends_s: list[float] = []

    def window_ended(self, first_frame: int) -> None:
        self._ends_s.append(time.monotonic())

    @property
    def later_s(self) -> float | None:
        """Seconds per frame after the first; None if there is only one frame."""
        ends_s = self._ends_s
        return (ends_s[-1] - ends_s[0]) / (len(ends_s) - 1) if len(ends_s) > 1 else None


def training(
    config: CudaConfig, capture: Path, backend: DeviceBackendName, num_frames: int, stream: Path
) -> TrainConfig:
    """The preset, applied to the first `num_frames` frames."""
    chosen = PRESETS[config.preset](
        capture, stream, frames=f"0:{num_frames}", longest_px=config.longest_px, backend=backend,
        torch_device=config.torch_device if backend == "torch" else None,
    )  # fmt: skip
    names = ("num_gs", "genesis_iterations", "settle_rounds", "window_iterations")
    given = {name: getattr(config, name) for name in names if getattr(config, name) is not None}
    return replace(chosen, fit=replace(chosen.fit, **given))


def with_slots(job: TrainConfig) -> TrainConfig:
    """The same training with slots that last a frame."""
    fit = replace(job.fit, swin_size=1)
    return replace(job, whole_slices=False, rank="contribution", fit=fit)


def in_parts(job: TrainConfig, config: CudaConfig, num_frames: int) -> TrainConfig:
    """The same training, with one part for each worker."""
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


def measured(
    config: CudaConfig, capture: Path, backend: DeviceBackendName, how: How, num_frames: int
) -> Measured:
    """Trains and scores. Host memory is that of this process; for parts, it is the driver's."""
    console, times = Console(stderr=True), WindowTimes()
    with tempfile.TemporaryDirectory() as folder:
        stream = Path(folder) / "stream"
        job = training(config, capture, backend, num_frames, stream)
        if open_capture(capture).fps is None:
            job = replace(job, fps=config.fps)
        if how != "preset":
            job = with_slots(job)
        begin_s = time.monotonic()
        if how == "parts":
            train_in_parts(in_parts(job, config, num_frames), LOCAL, console)
        else:
            train_stream(job, console, observers=[times])
        took_s = time.monotonic() - begin_s
        unit_bytes = 1 if sys.platform == "darwin" else 1024
        host_bytes = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit_bytes
        score = evaluate_stream(EvaluateConfig(stream, capture)).layers[-1]
    device_bytes = None if how == "parts" else device_peak_bytes()
    return Measured(
        capture.resolve().name, backend, how, num_frames, took_s / num_frames, times.later_s,
        score.psnr_db, score.ssim, device_bytes, host_bytes, score.bytes_per_frame,
    )  # fmt: skip


def in_a_process(
    failures: list[str], what: str, function: Callable[..., Row], *arguments: object
) -> Iterator[Row]:
    """Yields the result of `function`, computed in a process of its own. If a device lacks memory
    or the process dies, yields nothing and adds a line about `what` to `failures`."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as process:
        try:
            yield process.submit(function, *arguments).result()
        except (RuntimeError, MemoryError) as error:
            first = (str(error).strip() or type(error).__name__).partition("\n")[0]
            failures.append(f"not measured: {what}: {first}")


def step_rows(config: CudaConfig, failures: list[str]) -> Iterator[StepRow]:
    """Every number of Gaussians with every backend; for `failures` see `in_a_process`."""
    for count in config.sizes:
        for backend in config.backends:
            case = StepCase(
                backend, config.torch_device, count, config.width_px, config.height_px,
                config.steps,
            )  # fmt: skip
            what = f"a step of {count:,} Gaussians by {backend}"
            yield from in_a_process(failures, what, measured_step, case)


def rows(config: CudaConfig, captures: Sequence[Path], failures: list[str]) -> Iterator[Measured]:
    """Every capture at every length with every backend; then the trainings in parts."""
    for capture in captures:
        length = open_capture(capture).num_frames
        lengths = sorted({min(num_frames, length) for num_frames in config.frames})
        wanted: list[tuple[DeviceBackendName, How, int]] = [
            (backend, "preset", num_frames) for num_frames in lengths for backend in config.backends
        ]
        if config.ray_workers:
            for backend in config.backends:
                wanted += [(backend, "slots", lengths[-1]), (backend, "parts", lengths[-1])]
        for each in wanted:
            what = f"{capture.name}, {each[2]} frames by {each[0]}"
            yield from in_a_process(failures, what, measured, config, capture, *each)


def table_of(title: str, columns: Sequence[str], texts: Iterable[Sequence[str]]) -> Table:
    """A table of rows of texts."""
    table = Table(title=title)
    for name in columns:
        table.add_column(name, justify="right")
    for row in texts:
        table.add_row(*row)
    return table


def run(config: CudaConfig) -> None:
    where = []
    for backend in config.backends:
        # Refuses a machine without the backend before anything is read.
        job = training(config, Path("capture"), backend, 1, Path("stream"))
        where.append(job.fit.backend(backend, job.torch_device).why)
    title, console = "; ".join(where), Console(width=140)
    failures: list[str] = []
    steps = (row.texts for row in step_rows(config, failures))
    console.print(table_of(f"{title}: steps", STEP_COLUMNS, steps))
    with tempfile.TemporaryDirectory() as folder:
        captures = list(config.captures)
        if config.demo:
            captures.insert(0, Path(folder) / "demo")
            synthesise(SynthConfig(captures[0], frames=max(config.frames)))
        if captures:
            num_gs = training(config, captures[0], "torch", 1, Path("stream")).fit.num_gs
            trained = (row.texts for row in rows(config, captures, failures))
            name = f"{title}: preset {config.preset}, {num_gs:,} Gaussians"
            console.print(table_of(name, COLUMNS, trained))
    for failure in failures:
        console.print(failure, highlight=False, markup=False)


if __name__ == "__main__":
    run_command(CudaConfig, run, "scripts/bench cuda", "Times training on a GPU.")
