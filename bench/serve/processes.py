"""Processes under measurement: starts them on a core of their own, and reads their CPU time and
memory.

All figures are read from /proc, for a process and all its descendants, so that those of a server
include its workers.
"""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from codec.errors import SwingsError

ROOT = Path(__file__).parents[2]
TICKS = os.sysconf("SC_CLK_TCK")
PAGE_BYTES = os.sysconf("SC_PAGE_SIZE")


def pinned(core: int) -> list[str]:
    """Prefix of a command to run it on one core only. Raises SwingsError without taskset."""
    if shutil.which("taskset") is None:
        raise SwingsError("taskset is missing; install util-linux")
    return ["taskset", "-c", str(core)]


def two_cores() -> tuple[int, int]:
    """A core for the server and one for its clients. Raises SwingsError if there is only one."""
    cores = sorted(os.sched_getaffinity(0))
    if len(cores) < 2:
        raise SwingsError("the server and its clients need a core each; this machine has one")
    return cores[0], cores[1]


@contextmanager
def running(command: Sequence[object], **options: object) -> Iterator[subprocess.Popen[str]]:
    """Runs `command` during the block; ends it with SIGTERM, and with SIGKILL after 20 s."""
    process: subprocess.Popen[str] = subprocess.Popen(  # type: ignore[call-overload]
        [str(word) for word in command], text=True, **options
    )
    try:
        yield process
    finally:
        process.send_signal(signal.SIGTERM)
        try:
            process.wait(timeout=20)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        if process.stdout is not None:
            process.stdout.close()


@contextmanager
def serving(
    root: Path, *options: str, prefix: Sequence[str] = (), log: Path | None = None
) -> Iterator[tuple[int, int]]:
    """Runs swings-serve for `root`; gives its process id and port. prefix: words before the
    command. log: file for its stderr."""
    command = [*prefix, sys.executable, "-m", "server", str(root), "--port", "0", *options]
    with open(log or os.devnull, "w") as errors:
        environment = {**os.environ, "PYTHONPATH": str(ROOT)}
        streams = {"stdout": subprocess.PIPE, "stderr": errors if log else None}
        with running(command, env=environment, **streams) as process:
            assert process.stdout is not None
            match = re.fullmatch(r"serving http://[\d.]+:(\d+)\n", process.stdout.readline())
            if match is None:
                raise SwingsError("the server did not start")
            yield process.pid, int(match[1])


def family(pid: int) -> list[int]:
    """The process and all its descendants."""
    found, parents = [pid], [pid]
    while parents:
        children: list[int] = []
        for parent in parents:
            for task in Path(f"/proc/{parent}/task").glob("*/children"):
                children += map(int, _text(task).split())
        found += children
        parents = children
    return found


def cpu_s(pid: int) -> float:
    """CPU seconds, user and system, that the process and its descendants have used so far."""
    total = 0
    for member in family(pid):
        fields = _text(Path(f"/proc/{member}/stat")).rsplit(")", 1)[-1].split()
        total += int(fields[11]) + int(fields[12]) if fields else 0
    if not total and not Path("/proc/self/stat").exists():
        raise SwingsError("this benchmark reads CPU times from /proc; run it on Linux")
    return total / TICKS


def machine_cpu_s() -> float:
    """CPU seconds that all processes have used so far, on all cores together."""
    fields = Path("/proc/stat").read_text().splitlines()[0].split()[1:]
    user, nice, system, _, _, irq, softirq = map(int, fields[:7])
    return (user + nice + system + irq + softirq) / TICKS


def rss_bytes(pid: int) -> int:
    """Resident memory of the process and its descendants; shared pages count for each."""
    pages = 0
    for member in family(pid):
        fields = _text(Path(f"/proc/{member}/statm")).split()
        pages += int(fields[1]) if fields else 0
    return pages * PAGE_BYTES


def _text(path: Path) -> str:
    """Text of the file; empty if its process is gone."""
    try:
        return path.read_text()
    except OSError:
        return ""
