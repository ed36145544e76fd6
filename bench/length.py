"""Memory and training time per frame over the length of the video: both shall be the same at frame
3000 as at frame 30.

Usage: scripts/bench length --out docs/length.png

A small capture of ten frames is looped into videos of each length. Each is trained in a process of
its own, with all that `swings-train` runs: videos, picture cache, training, codec, quality,
checkpoint. The exit code is 1 if the memory of a run grows by more than 5 % after its first tenth,
or the time per frame by more than 10 % from the first tenth to the last. A tenth of a run below 100
frames is too short to judge time by: such a run compares ten frames and never fails on time.
"""

from __future__ import annotations

import multiprocessing
import os
import shutil
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from codec.arrays import Doubles

os.environ.setdefault("OMP_WAIT_POLICY", "passive")

import matplotlib.backends.backend_agg
import matplotlib.figure
import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from codec.console import run_command
from codec.errors import SwingsError
from trainer.capture.capture import HELD_OUT_NAME
from trainer.capture.dynerf import POINTS_NAME, POSES_NAME
from trainer.capture.layout import open_capture
from trainer.fit.config import FitConfig
from trainer.fit.observer import Observer
from trainer.run.config import TrainConfig
from trainer.run.job import train_stream
from trainer.synth.film import SynthConfig, VideoWriter, synthesise

LOOP_FRAMES = 10
"""Frames of the looped capture."""
MAX_MEMORY_GROWTH = 0.05
MAX_TIME_GROWTH = 0.10
LEAST_FRAMES = 10
"""Minimum frames of a median, for runs whose tenth is shorter: one loop."""
COLOURS = ("#d9480f", "#1f5fbf", "#2b8a3e", "#6b7280")


@dataclass(frozen=True)
class LengthConfig:
    """Trains a small looped capture at several lengths; tabulates and draws memory and time."""

    out: Path = Path("docs/length.png")
    """The plot to write."""
    frames: tuple[int, ...] = (30, 300, 3000)
    """Lengths to train, in frames."""
    num_gs: int = 300
    """Gaussians active in a frame."""
    swin_size: int = 3
    """Lifetime of a Gaussian, frames."""
    window_iterations: int = 20
    """Iterations of a window; the first window has five times as many."""
    cameras: int = 6
    """Cameras, one of them held out."""
    width_px: int = 64
    """Width of the pictures."""
    height_px: int = 36
    """Height of the pictures."""


@dataclass(frozen=True, slots=True)
class Track:
    """Time and memory of one run; one entry for each frame, read after its window."""

    seconds: list[float]
    """Seconds since the previous window; the first entry is genesis."""
    memory_bytes: list[int]
    """Resident memory."""
    peak_bytes: int

    @property
    def num_frames(self) -> int:
        return len(self.seconds)

    @property
    def tenth(self) -> int:
        return max(1, self.num_frames // 10)

    @property
    def early_bytes(self) -> int:
        """Resident memory after a tenth of the run."""
        return self.memory_bytes[self.tenth - 1]

    @property
    def end_bytes(self) -> int:
        return self.memory_bytes[-1]

    @property
    def memory_growth(self) -> float:
        """Growth from a tenth of the run to its end, as a share."""
        return self.end_bytes / self.early_bytes - 1

    def median_s(self, last: bool) -> float:
        """Median seconds per frame in the last or the first tenth, without genesis."""
        windows = self.seconds[1:]
        count = max(self.tenth, LEAST_FRAMES)
        return float(np.median(windows[-count:] if last else windows[:count]))

    @property
    def time_growth(self) -> float:
        """Growth from the first tenth of the run to the last, as a share."""
        return self.median_s(last=True) / self.median_s(last=False) - 1


def own_memory_bytes(field: str) -> int:
    """A field of this process's status: VmRSS (resident now) or VmHWM (peak so far)."""
    for line in Path("/proc/self/status").read_text().splitlines():
        name, _, value = line.partition(":")
        if name == field:
            return 1024 * int(value.split()[0])
    raise SwingsError(f"/proc/self/status has no {field}; this measurement needs Linux")


def make_loop(config: LengthConfig, folder: Path) -> Path:
    """Generates the capture of LOOP_FRAMES frames."""
    path = folder / "loop"
    synth = SynthConfig(
        path, frames=LOOP_FRAMES, cameras=config.cameras, held_out=1,
        width_px=config.width_px, height_px=config.height_px, points=2000,
    )  # fmt: skip
    synthesise(synth, Console(quiet=True))
    return path


def write_looped(loop: Path, path: Path, num_frames: int) -> None:
    """Writes the capture `loop`, repeated up to `num_frames` frames."""
    capture = open_capture(loop)
    assert capture.fps is not None  # its videos state it
    path.mkdir()
    for name in (POSES_NAME, HELD_OUT_NAME, POINTS_NAME):
        shutil.copy(loop / name, path / name)
    for index, camera in enumerate(capture.cameras):
        source = capture.open_images(index)
        pictures = [source.read(frame) for frame in range(capture.num_frames)]
        source.close()
        name = f"{camera.camera.name}.mp4"
        with VideoWriter(path / name, camera.camera, capture.fps) as video:
            for frame in range(num_frames):
                video.write(pictures[frame % len(pictures)])


class Recorder(Observer):
    """Records time and memory at the end of every window, and when the first one begins."""

    def __init__(self) -> None:
        self.times_s: list[float] = []
        self.memory_bytes: list[int] = []

    def window_begun(self, first_frame: int, done: int) -> None:
        if not self.times_s:
            self.times_s.append(time.perf_counter())

    def window_ended(self, first_frame: int) -> None:
        self.times_s.append(time.perf_counter())
        self.memory_bytes.append(own_memory_bytes("VmRSS"))


def train(config: LengthConfig, capture: Path, stream: Path) -> Track:
    """Trains `capture` in this process and records every window."""
    fit = FitConfig(
        num_gs=config.num_gs,
        swin_size=config.swin_size,
        genesis_iterations=5 * config.window_iterations,
        settle_rounds=0,
        window_iterations=config.window_iterations,
    )
    # Limited so that the cache is full within the first tenth of any run and does not grow later.
    picture_bytes = 3 * config.width_px * config.height_px
    cache_bytes = 2 * config.swin_size * config.cameras * picture_bytes
    job = TrainConfig(capture, stream, cache_bytes=cache_bytes, fit=fit)
    recorder = Recorder()
    train_stream(job, Console(quiet=True), observers=[recorder])
    # The kernel's two counters are read separately and may differ by a few pages.
    peak_bytes = max(*recorder.memory_bytes, own_memory_bytes("VmHWM"))
    return Track(np.diff(recorder.times_s).tolist(), recorder.memory_bytes, peak_bytes)


def measure(config: LengthConfig) -> list[Track]:
    """Trains each length, the shortest first."""
    log = Console(stderr=True)
    tracks = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        loop = make_loop(config, folder)
        # The run of the loop itself is not measured: it compiles whatever is not compiled yet.
        for num_frames in (0, *sorted(config.frames)):
            start = time.perf_counter()
            capture = folder / f"capture{num_frames}" if num_frames else loop
            if num_frames:
                write_looped(loop, capture, num_frames)
            context = multiprocessing.get_context("spawn")
            with ProcessPoolExecutor(1, context) as process:
                track = process.submit(
                    train, config, capture, folder / f"stream{num_frames}"
                ).result()
            elapsed_s = time.perf_counter() - start
            if num_frames:
                log.print(f"{num_frames} frames: {elapsed_s:.0f} s")
                tracks.append(track)
    return tracks


def table_of(tracks: Sequence[Track]) -> Table:
    table = Table(box=box.MARKDOWN)
    for name in (
        "frames", "frames/s, first tenth", "last tenth", "time per frame",
        "MB at 10 %", "MB at the end", "difference", "MB at most",
    ):  # fmt: skip
        table.add_column(name, justify="right")
    for track in tracks:
        table.add_row(
            f"{track.num_frames}",
            f"{1 / track.median_s(last=False):.1f}",
            f"{1 / track.median_s(last=True):.1f}",
            f"{track.time_growth:+.1%}",
            f"{track.early_bytes / 1e6:.1f}",
            f"{track.end_bytes / 1e6:.1f}",
            f"{track.memory_growth:+.1%}",
            f"{track.peak_bytes / 1e6:.1f}",
        )
    return table


def running_median(values: Doubles, count: int) -> Doubles:
    """Median of about `count` values around each value; of fewer at the ends."""
    half = count // 2
    return np.array(
        [np.median(values[max(0, i - half) : i + half + 1]) for i in range(len(values))], np.float64
    )


def draw(tracks: Sequence[Track], config: LengthConfig) -> None:
    figure = matplotlib.figure.Figure(figsize=(8, 6), layout="constrained")
    matplotlib.backends.backend_agg.FigureCanvasAgg(figure)
    memory, times = figure.subplots(2, 1, sharex=True)
    for i, track in reversed(list(enumerate(tracks))):
        colour, name = COLOURS[i % len(COLOURS)], f"{track.num_frames:,} frames"
        frames = np.arange(1, track.num_frames + 1)
        memory.plot(frames, np.array(track.memory_bytes) / 1e6, color=colour, label=name)
        milliseconds = 1e3 * np.array(track.seconds[1:])
        times.plot(frames[1:], milliseconds, ".", markersize=2, alpha=0.25, color=colour)
        times.plot(frames[1:], running_median(milliseconds, LEAST_FRAMES), color=colour, label=name)
    longest = max(tracks, key=lambda track: track.num_frames)
    top_ms = 2.5e3 * float(np.median(longest.seconds[1:]))
    memory.set_ylim(0, 1.25 * max(track.peak_bytes for track in tracks) / 1e6)
    times.set_ylim(0, top_ms)
    times.set_xscale("log")
    lengths = [track.num_frames for track in tracks]
    ticks = [1, *(10**n for n in range(1, 6) if 10**n <= 1.1 * longest.num_frames)]
    ticks = [tick for tick in ticks if all(abs(np.log(tick / n)) > 0.5 for n in lengths)] + lengths
    times.set_xticks(ticks, [f"{tick:,}" for tick in ticks])
    times.set_xticks([], minor=True)
    memory.set_ylabel("resident memory, MB")
    times.set_ylabel("time per frame, ms\n(line: running median)")
    times.set_xlabel("frames trained, logarithmic")
    for axes in (memory, times):
        axes.grid(alpha=0.3)
    memory.legend(loc="lower right", fontsize=9, title="length of the video", reverse=True)
    memory.set_title(
        f"{config.num_gs} Gaussians, swin_size {config.swin_size}, {config.cameras} cameras "
        f"{config.width_px}x{config.height_px}, {config.window_iterations} iterations per frame",
        fontsize=10,
    )
    config.out.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(config.out, dpi=120, metadata={"Software": None})


def complaints(tracks: Sequence[Track]) -> list[str]:
    """A line for each excessive growth; empty if there is none."""
    found = []
    for track in tracks:
        if track.memory_growth > MAX_MEMORY_GROWTH:
            found.append(f"{track.num_frames} frames: memory {track.memory_growth:+.1%}")
        if track.tenth >= LEAST_FRAMES and track.time_growth > MAX_TIME_GROWTH:
            found.append(f"{track.num_frames} frames: time per frame {track.time_growth:+.1%}")
    return found


def run(config: LengthConfig) -> None:
    if not config.frames or min(config.frames) < 2:
        raise SwingsError("frames: give lengths of at least 2")
    tracks = measure(config)
    console = Console(width=120)
    console.print(table_of(tracks))
    first, last = tracks[0], tracks[-1]
    console.print(
        f"At the end of {last.num_frames} frames against {first.num_frames}: "
        f"memory {last.end_bytes / first.end_bytes - 1:+.1%}"
    )
    draw(tracks, config)
    if found := complaints(tracks):
        raise SwingsError("; ".join(found))


if __name__ == "__main__":
    run_command(
        LengthConfig, run, "scripts/bench length", "Measures training over the length of a video."
    )
