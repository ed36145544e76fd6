"""Age of a slice when a client that follows a growing stream receives it.

A writer appends 30 frames per second in segments of 5, and clients play from the newest frame on.
Latency is the time from a segment's birth on disk, when its index record is written, until a client
has layer 0 of its first slice, and of its last.
"""

from __future__ import annotations

import json
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from codec.errors import SwingsError

from .heldplays import run_load
from .livewriter import LEAD_FRAMES
from .material import slice_size_of
from .playfigures import Seen, Spread, live_latency_s
from .playload import LoadConfig
from .processes import ROOT, pinned, running, serving

SETTLE_S = 2.0
"""Seconds after the clients' arrival in which segments do not count: the clients catch up."""


@dataclass(frozen=True, slots=True)
class LiveFigures:
    """Latencies in ms, over all clients and segments."""

    clients: int
    segments: int
    """Pairs of a client and a segment."""
    first_ms: Spread
    last_ms: Spread
    server_share: float


def measure_live(
    clients: int,
    frame_bytes: int,
    seconds: float,
    cores: tuple[int, int],
    options: tuple[str, ...],
) -> LiveFigures:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        stream, told = folder / "streams" / "show", folder / "born.txt"
        (folder / "streams").mkdir()
        script = Path(__file__).with_name("livewriter.py")
        slice_size = slice_size_of(frame_bytes)
        command: list[object] = [*pinned(cores[1]), sys.executable, script]
        command += [stream, slice_size, seconds + 10]
        with (
            open(told, "w") as born,
            running(command, stdout=born, env={"PYTHONPATH": str(ROOT)}),
        ):
            wait_for_lines(told, LEAD_FRAMES // 5)
            log = folder / "serve.log"
            server = serving(folder / "streams", *options, prefix=pinned(cores[0]), log=log)
            with server as (pid, port):
                from_frame = json.loads(told.read_text().splitlines()[-1])["end_birth"] - 1
                path, out = f"/v1/streams/show/play?from={from_frame}", folder / "seen.npz"
                began_s = time.time()
                config = LoadConfig(port, path, clients, 0.5, 1.0, seconds, pid, str(out))
                run_load(config, cores[1])
        lines = map(json.loads, told.read_text().splitlines())
        segments = {line["birth"]: (line["end_birth"], line["at_s"]) for line in lines}
        seen = Seen.read(out)
        first_s, last_s = live_latency_s(seen, segments, began_s + SETTLE_S)
        if not len(first_s):
            raise SwingsError("no client received a segment written during its play")
        spreads = Spread.of(1000 * first_s), Spread.of(1000 * last_s)
        return LiveFigures(clients, len(first_s), *spreads, seen.known["server_share"])


def wait_for_lines(path: Path, count: int) -> None:
    for _ in range(3000):
        if path.read_text().count("\n") >= count:
            return
        time.sleep(0.01)
    raise SwingsError("the writer of the live stream wrote nothing")


def show_live(figures: LiveFigures) -> None:
    Console().print(
        f"live, {figures.clients} clients, {figures.segments} segments received: first slice "
        f"{figures.first_ms.p50:.0f} ms after its birth (p99 {figures.first_ms.p99:.0f}), last "
        f"{figures.last_ms.p50:.0f} (p99 {figures.last_ms.p99:.0f}); server "
        f"{100 * figures.server_share:.0f} % of a core",
        soft_wrap=True,
    )
