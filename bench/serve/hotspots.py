"""CPU time of a running server by function, sampled from outside by py-spy."""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from codec.errors import SwingsError


@dataclass(frozen=True, slots=True)
class Hotspot:
    """A function's shares of all samples."""

    function: str
    own: float
    """Share of samples in the function itself, 0 to 1."""
    within: float
    """Share of samples in the function or its callees, 0 to 1."""


def hotspots_of(lines: Iterable[str], count: int) -> list[Hotspot]:
    """The `count` functions with the most samples of their own.

    lines: one for each stack, `outermost;...;innermost samples`, as written by
    `py-spy record -f raw`.
    """
    own: Counter[str] = Counter()
    within: Counter[str] = Counter()
    for line in lines:
        stack, _, samples = line.rstrip().rpartition(" ")
        # The outermost frame is the process; a sample between two functions has no other frame.
        frames = [frame for frame in stack.split(";") if not frame.startswith("process ")]
        if not samples.isdigit() or not frames:
            continue
        own[frames[-1]] += int(samples)
        for function in set(frames):
            within[function] += int(samples)
    total = max(1, own.total())
    return [Hotspot(name, n / total, within[name] / total) for name, n in own.most_common(count)]


def py_spy() -> str:
    """Path of py-spy. Raises SwingsError, which states how to install it."""
    beside = Path(sys.executable).with_name("py-spy")
    found = str(beside) if beside.exists() else shutil.which("py-spy")
    if found is None:
        raise SwingsError("--profile needs py-spy: .venv/bin/pip install py-spy")
    return found


@contextmanager
def sampled(pid: int, into: Path, rate_hz: int = 200) -> Iterator[None]:
    """Samples the process and its children during the block; then writes the stacks to `into`."""
    command = [py_spy(), "record", "--pid", str(pid), "--subprocesses", "--format", "raw"]
    command += ["--output", str(into), "--rate", str(rate_hz), "--nonblocking"]
    command += ["--nolineno", "--duration", "unlimited"]
    process = subprocess.Popen(
        command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    )
    try:
        yield
    finally:
        process.send_signal(2)  # at SIGINT py-spy writes its samples
        _, errors = process.communicate(timeout=60)
    if not into.exists():
        lines = errors.strip().splitlines() or ["no message"]
        raise SwingsError(f"py-spy could not sample the server: {lines[-1]}")
