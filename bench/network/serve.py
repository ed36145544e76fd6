"""What serving costs: objects per second and CPU seconds per gigabyte of one server process.

Usage: scripts/bench serve [--seconds 2] [--connections 8]

Loopback only, so the CPU seconds per gigabyte say more than the rates: clients and server share the
machine.
"""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from codec.camera import Camera
from codec.console import run_command
from codec.errors import SwingsError
from codec.profiles.profile import Profile
from codec.slice import Slice
from codec.splats import Splats
from codec.stream import StreamWriter
from codec.stream.manifest import Manifest

SEGMENT_FRAMES = 15
NUM_FRAMES = 45
SWIN_SIZE = 5
GAUSSIAN_BYTES = 56
"""Bytes of a raw Gaussian; noise does not shrink."""


@dataclass(frozen=True, slots=True)
class BenchConfig:
    """What to measure."""

    seconds: float = 2.0
    """Seconds for each row of the table."""
    connections: int = 8
    """Clients at the same time, each with one connection."""
    object_kb: tuple[int, ...] = (40, 100, 300, 1000)
    """Sizes of the objects, in thousands of bytes."""


@dataclass(frozen=True, slots=True)
class Row:
    """What one measurement gave."""

    what: str
    count: int
    num_bytes: int
    seconds: float
    cpu_s: float


def make_stream(path: Path, object_bytes: int) -> None:
    """A stream of noise whose objects have about `object_bytes`."""
    slice_size = max(4, 4 * object_bytes // SEGMENT_FRAMES // GAUSSIAN_BYTES)
    manifest = Manifest(
        fps=30.0,
        swin_size=SWIN_SIZE,
        num_gs=SWIN_SIZE * slice_size,
        layers=(0.25, 0.25, 0.25, 0.25),
        segment_frames=SEGMENT_FRAMES,
        sh_degree=0,
        profile=Profile.RAW,
        antialias=False,
        near_m=0.01,
        bounds=((-1.0, -1.0, -1.0), (1.0, 1.0, 1.0)),
        cameras=(Camera("front", 64, 48, 50.0, 50.0, 32.0, 24.0, np.eye(4)),),
        default_camera="front",
        live=False,
    )
    rng = np.random.default_rng(0)

    def noise(*shape: int) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
        return rng.normal(size=(slice_size, *shape)).astype(np.float32)

    with StreamWriter.create(path, manifest) as writer:
        for birth in range(manifest.first_birth, NUM_FRAMES):
            splats = Splats(noise(3), noise(3), noise(4), noise(), noise(1, 3))
            writer.append(Slice(birth, splats, np.zeros(slice_size, np.uint8)))


@contextmanager
def serving(root: Path, *options: str, prefix: Sequence[str] = ()) -> Iterator[tuple[int, int]]:
    """A server process of `root`: its process id and port. prefix: what runs it."""
    command = [*prefix, sys.executable, "-m", "server", str(root), "--port", "0", *options]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            match = re.fullmatch(r"serving http://[\d.]+:(\d+)\n", process.stdout.readline())
            if match is None:
                raise SwingsError("the server did not start")
            yield process.pid, int(match[1])
        finally:
            process.send_signal(signal.SIGTERM)


def cpu_s(pid: int) -> float:
    """CPU seconds, user and system, that the process has used so far."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    except OSError as error:
        raise SwingsError("this bench reads CPU times from /proc: run it on Linux") from error
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def read_objects(port: int, path: str, until_s: float) -> tuple[int, int]:
    """Objects and bytes that one connection got, one request after another."""
    request = f"GET {path} HTTP/1.1\r\nHost: bench\r\n\r\n".encode()
    buffer = memoryview(bytearray(1 << 20))
    count = num_bytes = 0
    with socket.create_connection(("127.0.0.1", port)) as sock:
        while time.monotonic() < until_s:
            sock.sendall(request)
            head = b""
            while b"\r\n\r\n" not in head:
                head += sock.recv(4096)
            length = re.search(rb"(?i)content-length: (\d+)", head)
            assert length is not None
            missing = int(length[1]) - (len(head) - head.index(b"\r\n\r\n") - 4)
            num_bytes += int(length[1])
            while missing > 0:
                missing -= sock.recv_into(buffer)
            count += 1
    return count, num_bytes


def read_plays(port: int, path: str, until_s: float) -> tuple[int, int]:
    """Slices and bytes that one client got, in one whole play after another."""
    buffer = memoryview(bytearray(1 << 20))
    count = num_bytes = 0
    while time.monotonic() < until_s:
        with socket.create_connection(("127.0.0.1", port)) as sock:
            sock.sendall(f"GET {path} HTTP/1.0\r\nHost: bench\r\n\r\n".encode())
            while received := sock.recv_into(buffer):
                num_bytes += received
        count += NUM_FRAMES + SWIN_SIZE - 1
    return count, num_bytes


def measure(
    what: str, pid: int, config: BenchConfig, read: Callable[[float], tuple[int, int]]
) -> Row:
    """Runs `read` on every connection at once and reads the server's CPU time around it."""
    results: list[tuple[int, int]] = []
    began_s, before_s = time.monotonic(), cpu_s(pid)
    until_s = began_s + config.seconds
    threads = [
        threading.Thread(target=lambda: results.append(read(until_s)))
        for _ in range(config.connections)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    if len(results) != config.connections:
        raise SwingsError(f"{what}: a client failed")
    seconds, used_s = time.monotonic() - began_s, cpu_s(pid) - before_s
    return Row(what, sum(r[0] for r in results), sum(r[1] for r in results), seconds, used_s)


def show(rows: list[Row]) -> None:
    table = Table("what", "per second", "MB/s", "server CPU", "CPU s per GB")
    for row in rows:
        table.add_row(
            row.what,
            f"{row.count / row.seconds:.0f}",
            f"{row.num_bytes / row.seconds / 1e6:.0f}",
            f"{100 * row.cpu_s / row.seconds:.0f} %",
            f"{row.cpu_s / (row.num_bytes / 1e9):.2f}",
        )
    Console().print(table)


def run(config: BenchConfig) -> None:
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        for size_kb in config.object_kb:
            make_stream(root / f"kb{size_kb}", size_kb * 1000)
        # A lead as long as the stream: plays then run as fast as the server can.
        unpaced = ("--target-lead-s", "1000", "--burst-s", "1000")
        with serving(root, *unpaced) as (pid, port):
            for size_kb in config.object_kb:
                path = f"/v1/streams/kb{size_kb}/segments/1/2"
                what = f"objects of {size_kb} KB"
                rows.append(measure(what, pid, config, partial(read_objects, port, path)))
            for size_kb in config.object_kb:
                path = f"/v1/streams/kb{size_kb}/play?layers=4"
                what = f"slices of {4 * size_kb // SEGMENT_FRAMES} KB in plays"
                rows.append(measure(what, pid, config, partial(read_plays, port, path)))
    show(rows)


def main() -> None:
    run_command(
        BenchConfig, run, "scripts/bench serve", "Measures what serving costs, over loopback."
    )


if __name__ == "__main__":
    main()
