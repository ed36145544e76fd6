"""Many clients of /play at once, held for a while; see `playfigures` for the figures.

The server has a core of its own; the clients, one process, have another. All clients play the same
stream from its start, but not in step, because they arrive one after the other.
"""

from __future__ import annotations

import subprocess
import tempfile
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

from rich.console import Console
from rich.table import Table

from codec.errors import SwingsError
from server.abr.session import SessionConfig

from .material import FPS, NUM_LAYERS, write_noise
from .playfigures import PlayFigures, Seen, Shape, Spread, figures_of
from .playload import LoadConfig, load_command
from .processes import pinned, serving

SEGMENT_FRAMES = 30
REST_S = SessionConfig().rest_s
"""The server's, to which the pacing is compared."""
PLAYS_PER_REST = 100
"""swings-serve lengthens a rest at random, up to twice its length, and by one more length per this
many running plays."""


def measure_plays(
    clients: int,
    frame_bytes: int,
    arrive_s: float,
    seconds: float,
    cores: tuple[int, int],
    options: tuple[str, ...],
    around: Callable[[int], ExitStack],
) -> PlayFigures:
    """Raises SwingsError if the clients fail. around: see measure_objects."""
    with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
        folder = Path(name)
        # The stream, with the lead, must not end before the measurement does.
        num_frames = round((seconds + 15) * FPS)
        write_noise(folder / "streams" / "long", frame_bytes, num_frames, SEGMENT_FRAMES)
        limits = ("--max-plays", str(clients + 16))
        prefix, log = pinned(cores[0]), folder / "serve.log"
        server = serving(folder / "streams", *limits, *options, prefix=prefix, log=log)
        pid, port = stack.enter_context(server)
        stack.enter_context(around(pid))
        path, out = "/v1/streams/long/play?from=0", folder / "seen.npz"
        settle_s = min(5.0, (seconds - arrive_s) / 3)
        config = LoadConfig(port, path, clients, arrive_s, settle_s, seconds, pid, str(out))
        run_load(config, cores[1])
        max_rest_s = REST_S * (2 + clients / PLAYS_PER_REST)
        shape = Shape(FPS, NUM_LAYERS, REST_S, max_rest_s)
        return figures_of(Seen.read(out), shape, frame_bytes)


def run_load(config: LoadConfig, core: int) -> None:
    """Runs the clients until they end. Raises SwingsError if they fail."""
    root = Path(__file__).parents[2]
    done = subprocess.run(
        load_command(config, core), env={"PYTHONPATH": str(root)}, capture_output=True, text=True
    )
    if done.returncode:
        raise SwingsError(f"the clients failed: {done.stderr.strip().splitlines()[-1:]}")


def show_plays(figures: PlayFigures) -> None:
    table = Table(f"{figures.clients} plays", "p50", "p99", "max")
    rows: dict[str, Spread] = {
        "head, ms": figures.head_ms,
        "first record, ms": figures.record_ms,
        "first picture, ms": figures.picture_ms,
        "slices late, ms": figures.late_ms,
        "gap beyond the pacing, ms": figures.beyond_ms,
        "rest found, ms": figures.rest_ms,
    }
    for what, spread in rows.items():
        table.add_row(what, f"{spread.p50:.1f}", f"{spread.p99:.1f}", f"{spread.max:.1f}")
    console = Console()
    console.print(table)
    console.print(
        f"failed {figures.failed}, missing {figures.missing}, double {figures.double}; "
        f"{figures.layers:.2f} layers a slice, {figures.bytes_per_s / 1e6:.0f} MB/s; "
        f"server {100 * figures.server_share:.0f} % of a core, "
        f"{figures.server_rss_bytes / 1e6:.0f} MB; clients "
        f"{100 * figures.load_share:.0f} % of theirs, {figures.load_longest_ms:.0f} ms at once; "
        f"others {100 * figures.others_share:.0f} %",
        soft_wrap=True,
    )
    if figures.load_share > 0.9:
        console.print(
            "The clients used up their core: the figures describe the clients, not the server."
        )
    if figures.others_share > 0.1:
        console.print("Other processes used the CPU: measure again when the machine is idle.")
