"""Workers of swings-serve that are killed while clients play; see `resumefigures` for the figures.

Every `every_s` seconds a running worker, chosen at random, gets a SIGKILL and is restarted at once.
With an `every_s` below one second the other worker serves alone and overloaded most of the time. It
sends fewer layers first, and then answers 503 to returning clients.
"""

from __future__ import annotations

import json
import math
import os
import random
import signal
import subprocess
import tempfile
import time
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from codec.errors import SwingsError

from .material import FPS, write_noise
from .playfigures import Spread
from .processes import ROOT, serving
from .resumefigures import Kill, ResumeFigures, resume_figures
from .resumeload import ResumeConfig, resume_command

SEGMENT_FRAMES = 30


@dataclass(frozen=True, slots=True)
class KillConfig:
    """Number and interval of the kills, and the load."""

    kills: int = 100
    every_s: float = 3.0
    """Seconds between two kills."""
    clients: int = 50
    workers: int = 2
    frame_bytes: int = 20_000
    """Bytes of a frame with all its layers."""
    max_lead_s: float = 6.0
    """The server's --max-lead-s; a returning client is sent that lead at once."""
    arrive_s: float = 3.0
    """Seconds over which the clients arrive; the kills begin after twice this time."""
    tells_rate: bool = True
    """Whether a returning client sends the link rate that the server last reported to it."""
    seed: int = 0


def measure_kills(config: KillConfig, options: tuple[str, ...] = ()) -> ResumeFigures:
    """options: more options of swings-serve. Raises SwingsError if the server or clients fail."""
    seconds = 2 * config.arrive_s + config.kills * config.every_s
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        # The lead must not reach the end of the stream.
        num_frames = round((seconds + 15) * FPS)
        write_noise(folder / "streams" / "long", config.frame_bytes, num_frames, SEGMENT_FRAMES)
        log, out = folder / "serve.log", folder / "seen.npz"
        words = ["--log", "json", "--workers", str(config.workers)]
        words += ["--max-lead-s", str(config.max_lead_s)]
        words += ["--max-plays", str(config.clients + 16)]
        with serving(folder / "streams", *words, *options, log=log) as (_, port):
            load = ResumeConfig(
                port=port,
                path="/v1/streams/long",
                clients=config.clients,
                arrive_s=config.arrive_s,
                fps=FPS,
                out=str(out),
                tells_rate=config.tells_rate,
            )
            with subprocess.Popen(
                resume_command(load),
                env={**os.environ, "PYTHONPATH": str(ROOT)},
                stdin=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
            ) as clients:
                time.sleep(2 * config.arrive_s)
                kills = _kill_again_and_again(config, log)
                _, said = clients.communicate()
            if clients.returncode:
                raise SwingsError(f"the clients failed: {said.strip().splitlines()[-1:]}")
        return resume_figures(out, kills, FPS, config.max_lead_s)


def _events(log: Path, *kinds: str) -> list[dict[str, Any]]:
    """The lines of the server's log with events of these kinds."""
    lines = [json.loads(line) for line in log.read_text().splitlines() if line.startswith("{")]
    return [line for line in lines if line.get("event") in kinds]


def _kill_again_and_again(config: KillConfig, log: Path) -> list[Kill]:
    """Kills workers; returns the kills, with the times at which the workers were replaced."""
    rng, kills = random.Random(config.seed), list[Kill]()
    offset_s = time.time() - time.monotonic()
    for _ in range(config.kills):
        due_s = time.monotonic() + config.every_s
        living = {line["pid"]: line["worker"] for line in _events(log, "worker_ready")}
        for line in _events(log, "worker_ended"):
            living.pop(line["pid"], None)
        if not living:
            raise SwingsError("no worker was restarted: kill workers less often")
        pid = rng.choice(sorted(living))
        kills.append(Kill(time.monotonic(), living[pid]))
        os.kill(pid, signal.SIGKILL)
        time.sleep(max(0.0, due_s - time.monotonic()))
    ready = [
        (datetime.fromisoformat(line["time"]).timestamp() - offset_s, line["worker"])
        for line in _events(log, "worker_ready")
    ]
    return [replace(kill, restart_s=_next_ready_s(kill, ready)) for kill in kills]


def _next_ready_s(kill: Kill, ready: list[tuple[float, int]]) -> float:
    # The log truncates times to milliseconds.
    times_s = [at_s for at_s, place in ready if place == kill.place and at_s > kill.at_s - 0.001]
    return max(kill.at_s, min(times_s, default=math.nan))


def show_kills(figures: ResumeFigures) -> None:
    table = Table(f"{figures.kills} kills, {figures.clients} clients", "p50", "p99", "max")
    rows: dict[str, Spread] = {
        "restart, ms": figures.restart_ms,
        "resume, ms": figures.resume_ms,
        "others' gap, ms": figures.gap_ms,
        "others' usual gap, ms": figures.usual_ms,
        "layers lost": figures.lost_layers,
    }
    for what, spread in rows.items():
        table.add_row(what, f"{spread.p50:.1f}", f"{spread.p99:.1f}", f"{spread.max:.1f}")
    console = Console()
    console.print(table)
    console.print(
        f"{figures.victims} plays cut, {figures.lost} not resumed; {figures.bystanders} others, "
        f"{figures.broken} of them broken; missing {figures.missing}, double {figures.double}; "
        f"{figures.before:.2f} layers a slice before, {figures.after:.2f} after; "
        f"stalls {figures.stalls}, refused {figures.refused}, "
        f"other responses {figures.answered}; status reports {figures.reports}, "
        f"{figures.slowest_report_ms:.0f} ms at most",
        soft_wrap=True,
    )
