"""Cost of serving: objects compared with nginx and with aiohttp's bare web.Response, held plays,
live latency, and the effect of killed workers on clients.

Usage: scripts/bench serve [--parts objects plays live kills] [--quick] [--json FILE] [--profile]

The server gets one core and its clients another, except in the part kills. `objectrate`,
`playfigures`, `livelatency` and `resumefigures` define the figures. The bench needs Debian's nginx
and wrk, and py-spy for --profile.
"""

from __future__ import annotations

import json
import tempfile
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from bench.serve.heldplays import measure_plays, show_plays
from bench.serve.hotspots import hotspots_of, sampled
from bench.serve.killedworkers import KillConfig, measure_kills, show_kills
from bench.serve.livelatency import measure_live, show_live
from bench.serve.objectrate import measure_objects, show_objects
from bench.serve.processes import two_cores
from codec.console import run_command


class Part(StrEnum):
    OBJECTS = "objects"
    PLAYS = "plays"
    LIVE = "live"
    KILLS = "kills"


@dataclass(frozen=True, slots=True)
class BenchConfig:
    """Measurements and their sizes."""

    parts: tuple[Part, ...] = (Part.OBJECTS, Part.PLAYS, Part.LIVE)
    """Measurements to run; 100 kills take five minutes."""
    quick: bool = False
    """Fewer and shorter rounds, as a smoke test; do not report their figures."""
    json: Path | None = None
    """File for all figures."""
    profile: bool = False
    """Also profile the server's CPU time with py-spy; do not report the figures of such a run."""
    object_kb: tuple[int, ...] = (40, 100, 300, 1000)
    """Sizes of the objects, in thousands of bytes."""
    connections: int = 8
    """Connections of wrk: viewers that fetch objects from one worker at the same time."""
    rounds: int = 5
    """Number of rounds; the median counts."""
    round_s: float = 2.0
    """Seconds that each server is measured in each round."""
    clients: int = 500
    """Number of concurrent plays."""
    frame_kb: float = 12.0
    """Size of a frame of the plays with all its layers, in thousands of bytes."""
    arrive_s: float = 10.0
    """Seconds over which the plays begin."""
    plays_s: float = 30.0
    """Seconds from the start of the first play to the end of all plays."""
    live_clients: int = 20
    """Number of plays that follow a live stream."""
    live_s: float = 15.0
    """Seconds for which these plays follow the live stream."""
    kills: int = 100
    """Number of workers to kill."""
    options: tuple[str, ...] = ()
    """Options for swings-serve, one word each; give them as `--options=--workers --options=1`."""


def run(config: BenchConfig) -> None:
    cores = two_cores()
    quick, figures = config.quick, dict[str, Any]()
    frame_bytes = round(1000 * config.frame_kb)
    with tempfile.TemporaryDirectory() as folder:
        stacks = Path(folder) / "stacks.txt"

        def around(pid: int) -> ExitStack:
            stack = ExitStack()
            if config.profile:
                stack.enter_context(sampled(pid, stacks))
            return stack

        if Part.OBJECTS in config.parts:
            rounds = (1, 1.0) if quick else (config.rounds, config.round_s)
            rates = measure_objects(
                config.object_kb, *rounds, config.connections, cores, config.options, around
            )
            show_objects(rates)
            figures["objects"] = [asdict(rate) for rate in rates]
            show_hotspots(stacks)
        if Part.PLAYS in config.parts:
            clients = min(50, config.clients) if quick else config.clients
            times = (2.0, 8.0) if quick else (config.arrive_s, config.plays_s)
            plays = measure_plays(clients, frame_bytes, *times, cores, config.options, around)
            show_plays(plays)
            figures["plays"] = asdict(plays)
            show_hotspots(stacks)
    if Part.LIVE in config.parts:
        seconds = 6.0 if quick else config.live_s
        live = measure_live(config.live_clients, frame_bytes, seconds, cores, config.options)
        show_live(live)
        figures["live"] = asdict(live)
    if Part.KILLS in config.parts:
        kills = KillConfig(kills=5 if quick else config.kills)
        killed = measure_kills(kills, config.options)
        show_kills(killed)
        figures["kills"] = asdict(killed)
    if config.json:
        config.json.write_text(json.dumps(figures, indent=1) + "\n")


def show_hotspots(stacks: Path, count: int = 25) -> None:
    """Shows the sampled functions, if there are any, and deletes the samples."""
    if not stacks.exists():
        return
    table = Table("function", "itself", "with what it calls")
    for spot in hotspots_of(stacks.read_text().splitlines(), count):
        table.add_row(spot.function, f"{100 * spot.own:.1f} %", f"{100 * spot.within:.1f} %")
    Console().print(table)
    stacks.unlink()


def main() -> None:
    about = "Measures the cost of serving over loopback, compared with nginx and aiohttp."
    run_command(BenchConfig, run, "scripts/bench serve", about)


if __name__ == "__main__":
    main()
