"""Time from the command to a picture: a new process with a window each time, and a local server.

Usage: scripts/bench start [--stream PATH] [--rounds 9]
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from bench.network.seek import SeekConfig, make_stream
from bench.serve.processes import ROOT, serving
from codec.console import run_command
from codec.errors import SwingsError
from codec.stream import StreamReader
from codec.stream.manifest import MANIFEST_NAME
from codec.stream.poster import POSTER_NAME, write_poster
from player.render.cpu import render_splats
from tests.support.screen.xserver import XVFB, x_server

PATIENCE_S = 120.0

STEPS = ("the player is loaded", "the poster shows", "the first frame shows")

# Ends once the window has shown its second picture; the first is the poster.
PLAYER = """
import json, os, sys, time
import glfw
told, swap = [], glfw.swap_buffers

def swap_buffers(window):
    swap(window)
    told.append(time.time())
    if len(told) == 3:
        print(json.dumps(told), flush=True)
        os._exit(0)

glfw.swap_buffers = swap_buffers
from player.__main__ import main
told.append(time.time())
main()
"""


@dataclass(frozen=True, slots=True)
class StartConfig:
    """Opens a window on a served stream repeatedly."""

    stream: Path | None = None
    """A stream with a poster; by default a synthetic stream that resembles a trained stream."""
    num_gs: int = 40_000
    """Gaussians of the synthetic stream."""
    rounds: int = 9
    """Number of windows to open; one more window before them warms the caches."""


@contextmanager
def display() -> Iterator[str]:
    """The name of the existing display, or of one in memory."""
    if name := os.environ.get("DISPLAY"):
        yield name
    elif XVFB is None:
        raise SwingsError("there is neither a screen nor Xvfb; install xvfb")
    else:
        with x_server() as name:
            yield name


def start(url: str, screen: str) -> list[float]:
    """Seconds from the start of the process to each of STEPS."""
    began_s = time.time()
    done = subprocess.run(
        [sys.executable, "-c", PLAYER, url],
        cwd=ROOT,
        env={**os.environ, "DISPLAY": screen},
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )
    if done.returncode != 0:
        raise SwingsError(f"the player failed: {done.stderr.strip()}")
    return [told_s - began_s for told_s in json.loads(done.stdout)]


def make_poster(stream: Path) -> None:
    """Enters a poster in the manifest, and draws it."""
    manifest = replace(StreamReader(stream).manifest, poster=POSTER_NAME)
    (stream / MANIFEST_NAME).write_bytes(manifest.to_json())
    write_poster(stream, render_splats)


def run(config: StartConfig) -> None:
    with tempfile.TemporaryDirectory() as folder, display() as screen:
        stream = config.stream or Path(folder) / "stream"
        if config.stream is None:
            make_stream(stream, SeekConfig(num_gs=config.num_gs, num_frames=60))
            make_poster(stream)
        elif StreamReader(stream).manifest.poster is None:
            raise SwingsError(f"{stream} has no poster")
        with serving(stream, "--log", "json", log=Path(folder) / "log") as (_, port):
            url = f"http://127.0.0.1:{port}"
            start(url, screen)
            found = np.array([start(url, screen) for _ in range(config.rounds)])
    table = Table("seconds from the command", "p50", "min", "max")
    for step, values in zip(STEPS, found.T, strict=True):
        cells = np.median(values), values.min(), values.max()
        table.add_row(step, *(f"{cell:.2f}" for cell in cells))
    Console().print(table)


def main() -> None:
    run_command(StartConfig, run, "start", "Measures the start-up time of the player's window.")


if __name__ == "__main__":
    main()
