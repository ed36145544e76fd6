"""A capture trained in parts on Ray clusters of this machine: time, deaths and memory.

Usage: scripts/bench parts CAPTURE --work FOLDER [--workers 1 2 4] [--kills 20] ...

Every worker has one core of the cluster and one thread; a cluster with more workers than this
machine has cores is marked as oversubscribed. "over perfect" is the measured time divided by the
time of a perfect speed-up from the first cluster. In the row with kills, workers are killed by
SIGKILL at random moments. The row with many parts trains the same frames in shorter parts. Memory
is the peak resident memory of the driver, and of the worker with the largest peak.
"""

from __future__ import annotations

import contextlib
import math
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro
from rich.console import Console
from rich.table import Table

from bench.serve.processes import family
from codec.console import run_command
from codec.errors import InvalidError
from codec.tools.audit import verify_stream
from trainer.parts.raydriver import keeping_signals
from trainer.run.monitor import LOG_NAME

LOOK_S = 0.1
"""Interval between two looks at the processes, seconds."""

WORKER = b"ray::do_task"
"""Part of the command line of a Ray worker that trains."""


@dataclass(frozen=True)
class PartsConfig:
    """Trains a capture on clusters of several sizes, and on a cluster whose workers are killed."""

    capture: tyro.conf.Positional[Path]
    """Folder of the recording."""
    work: Path
    """Folder for the streams."""
    frames: str = ":"
    """Frames of the capture to train, A:B."""
    workers: tuple[int, ...] = (1, 2, 4)
    """Workers of each cluster; the first cluster is the reference."""
    kills: int = 20
    """Workers to kill in one more run, on the second cluster."""
    parts: tuple[int, int, int] = (60, 30, 30)
    """Frames of a part, frames of its seam, and warm-up frames before it."""
    many_parts: tuple[int, int, int] = (6, 2, 4)
    """The same three numbers for the run with many parts."""
    num_gs: int = 3_000
    """Gaussians active in a frame."""
    genesis_iterations: int = 600
    """Iterations of the first window."""
    settle_rounds: int = 2
    """Settle rounds of the first window."""
    window_iterations: int = 60
    """Iterations of every later window."""
    seed: int = 1
    """Seed of the times at which workers are killed."""


@dataclass(frozen=True, slots=True)
class Run:
    """One training run."""

    stream: Path
    workers: int
    parts: tuple[int, int, int]
    kills: int = 0


@dataclass(frozen=True, slots=True)
class Trained:
    """Figures of a finished run."""

    took_s: float
    killed: int
    driver_bytes: int
    worker_bytes: int


def processes(words: bytes) -> list[int]:
    """Process ids of this process's descendants whose command line contains `words`."""
    found = []
    for process in family(os.getpid()):
        with contextlib.suppress(OSError):
            line = Path(f"/proc/{process}/cmdline").read_bytes()
            if words in line.replace(b"\0", b" "):
                found.append(process)
    return found


def peak_bytes(process: int) -> int:
    """Peak resident memory of a process; 0 if it is gone."""
    with contextlib.suppress(OSError):
        text = Path(f"/proc/{process}/status").read_text()
        if found := re.search(r"VmHWM:\s+(\d+)", text):
            return 1024 * int(found[1])
    return 0


@contextmanager
def cluster_of(workers: int) -> Iterator[str]:
    """Starts a cluster on this machine with a core for each worker; gives its address."""
    from ray.cluster_utils import Cluster

    with keeping_signals():
        cluster: Any = Cluster(initialize_head=True, head_node_args={"num_cpus": workers})
    try:
        yield cluster.address
    finally:
        cluster.shutdown()


class Killer:
    """Kills workers at random moments."""

    def __init__(self, kills: int, every_s: float, seed: int) -> None:
        self._left, self._every_s, self._rng = kills, every_s, random.Random(seed)
        self.killed = 0
        self._next_s = self._later()

    def _later(self) -> float:
        return time.monotonic() + self._rng.uniform(0.2, 1.8) * self._every_s

    def look(self) -> None:
        """Kills a worker if one is due."""
        if not self._left or time.monotonic() < self._next_s:
            return
        found = processes(WORKER)
        if found:
            os.kill(self._rng.choice(found), signal.SIGKILL)
            self._left -= 1
            self.killed += 1
            self._next_s = self._later()


def trained(config: PartsConfig, run: Run, killer: Killer) -> Trained:
    """Trains with a real driver and real workers, and verifies the stream."""
    shutil.rmtree(run.stream, ignore_errors=True)
    part_frames, seam_frames, warm_frames = run.parts
    with cluster_of(run.workers) as address:
        words = [
            config.capture, run.stream, "--frames", config.frames, "--ray", address,
            "--worker-cpus", 1, "--part-frames", part_frames, "--seam-frames", seam_frames,
            "--warm-frames", warm_frames, "--segment-frames", math.gcd(part_frames, seam_frames),
            "--num-gs", config.num_gs, "--genesis-iterations", config.genesis_iterations,
            "--settle-rounds", config.settle_rounds,
            "--window-iterations", config.window_iterations,
        ]  # fmt: skip
        code = "import sys; from trainer.__main__ import train; sys.exit(train())"
        begin_s, driver_bytes, worker_bytes = time.monotonic(), 0, 0
        driver = subprocess.Popen([sys.executable, "-c", code, *map(str, words)])
        while driver.poll() is None:
            driver_bytes = max(driver_bytes, peak_bytes(driver.pid))
            worker_bytes = max(worker_bytes, *map(peak_bytes, processes(WORKER)), 0)
            killer.look()
            time.sleep(LOOK_S)
        took_s = time.monotonic() - begin_s
    if driver.returncode:
        raise InvalidError(f"{run.stream}: training ended with {driver.returncode}")
    verify_stream(run.stream)
    return Trained(took_s, killer.killed, driver_bytes, worker_bytes)


def contents(stream: Path) -> dict[str, bytes]:
    """The files of a stream without the training log, which contains times."""
    files = (f for f in stream.rglob("*") if f.is_file() and f.name != LOG_NAME)
    return {str(f.relative_to(stream)): f.read_bytes() for f in files}


def runs(config: PartsConfig) -> list[Run]:
    """All runs; the others are compared with the first."""
    found = [Run(config.work / f"by{n}", n, config.parts) for n in config.workers]
    last = config.workers[-1]
    if config.kills:
        found.append(Run(config.work / "killed", last, config.parts, config.kills))
    return [*found, Run(config.work / "many", last, config.many_parts)]


def measure(config: PartsConfig) -> None:
    """Trains every run and prints the table."""
    cores = os.cpu_count() or 1
    config.work.mkdir(parents=True, exist_ok=True)
    table = Table(title=f"{cores} cores, a thread for each worker; all streams verified")
    for name in (
        "workers", "frames of a part", "killed", "s", "over perfect", "same bytes", "driver MB",
        "worker MB",
    ):  # fmt: skip
        table.add_column(name, justify="right")
    first: Trained | None = None
    took_s: dict[int, float] = {}  # by number of workers, of runs without kills
    for run in runs(config):
        # Spreads the kills over twice the time, because they make the run about twice as long.
        every_s = 2 * took_s[run.workers] / run.kills if run.kills else 0.0
        row = trained(config, run, Killer(run.kills, every_s, config.seed))
        took_s.setdefault(run.workers, row.took_s)
        first = first or row
        over = same = "-"
        if run.parts == config.parts:
            same = "yes" if contents(run.stream) == contents(runs(config)[0].stream) else "NO"
            if not run.kills:
                over = f"{row.took_s * run.workers / (first.took_s * config.workers[0]):.2f}"
        table.add_row(
            f"{run.workers}{' (oversubscribed)' if run.workers > cores else ''}",
            str(run.parts[0]), str(row.killed), f"{row.took_s:.0f}", over, same,
            f"{row.driver_bytes / 1e6:.0f}", f"{row.worker_bytes / 1e6:.0f}",
        )  # fmt: skip
    Console().print(table)


if __name__ == "__main__":
    run_command(PartsConfig, measure, "bench parts", __doc__ or "")
