"""The simulator compared with the real server and player: the same stream over the same links, once
in virtual time, once over the emulated link, and once over a token bucket of the kernel.

Usage: scripts/bench delivery STREAM --traces DIR [--loads 1] [--capture CAPTURE]

Plays the first trace of each folder under DIR, scaled to the load (see swings-abr). tbf needs root
and Linux's network namespaces, and has no latency except that of its queue. With --capture, the
shown frames are rendered and compared with the capture; see shown.py.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean
from typing import Annotated, Any

os.environ.setdefault("OMP_WAIT_POLICY", "passive")

import tyro
from rich import box
from rich.console import Console
from rich.table import Table

from bench.network.shaped import TCP_SHARE, shaped_link, why_not
from bench.network.shown import shown_scores
from bench.serve.processes import serving
from codec.console import run_command
from codec.errors import SwingsError
from codec.stream import StreamReader
from server.abr.link import Link, LinkStep
from server.study.choice import OWN
from server.study.config import Rules
from server.study.looped import LoopedMedia, open_media
from server.study.study import Case, at_load, run_play
from server.study.tracefolder import read_traces
from trainer.score.truth import open_held_out

REQUEST_BYTES = 500
"""Bytes after which the token bucket starts the trace: the play's request has passed."""

LATENCY_S = 0.02
"""Latency of a trace that states none."""


@dataclass(frozen=True, slots=True)
class DeliveryConfig:
    """Plays to compare."""

    stream: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="STREAM")]]
    """Folder of a finished stream."""
    traces: Path
    """Folder of folders of traces."""
    loads: tuple[float, ...] = (1.0,)
    """Ratios of the links' mean rate to the rate of the stream."""
    capture: Path | None = None
    """The capture that the stream was trained from."""


@dataclass(frozen=True, slots=True)
class Played:
    """Figures of one play."""

    where: str
    layers: float
    waited_s: float
    """Wait before the first frame and in stalls."""
    stalls: int
    predicted_db: float | None = None
    rendered_db: float | None = None
    """None without a capture."""


def simulated(media: LoopedMedia, case: Case) -> Played:
    _, shown, clock = run_play(media, case, OWN, Rules())
    assert clock.started_s is not None
    return Played(
        "simulated",
        fmean(one.layers for one in shown),
        clock.started_s + clock.stalled_s,
        clock.stalls,
        fmean(one.psnr_db for one in shown),
    )


def over_relay(stream: Path, link: Link, folder: Path) -> dict[str, Any]:
    """The report of a play over the emulated link."""
    trace = folder / "link.json"
    steps = [
        {
            "duration_ms": 1e3 * step.duration_s,
            "bandwidth_kbps": step.rate_bps / 1e3,
            "latency_ms": 1e3 * step.latency_s,
        }
        for step in link.steps
    ]
    trace.write_text(json.dumps(steps))
    with (
        serving(stream) as (_, port),
        playing(f"http://127.0.0.1:{port}", folder, "--link", str(trace)) as player,
    ):
        player.wait()
    return read_report(folder)


def over_tbf(stream: Path, link: Link, folder: Path) -> dict[str, Any]:
    """The report of a play over a token bucket."""
    with ExitStack() as stack:
        shaped = stack.enter_context(shaped_link(link))
        behind = serving(stream, "--host", shaped.host, prefix=shaped.inside())
        _, port = stack.enter_context(behind)
        player = stack.enter_context(playing(f"http://{shaped.host}:{port}", folder))
        shaped.start(after_bytes=REQUEST_BYTES)
        player.wait()
    return read_report(folder)


@contextmanager
def playing(url: str, folder: Path, *options: str) -> Iterator[subprocess.Popen[bytes]]:
    """A player process that writes a report into `folder`."""
    command = [sys.executable, "-m", "player", url, *options]
    command += ["--capture", str(folder / "play.mp4"), "--size", "320x180", "--renderer", "cpu"]
    command += ["--report", str(folder / "report.json")]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL) as player:
        try:
            yield player
        finally:
            player.terminate()


def read_report(folder: Path) -> dict[str, Any]:
    path = folder / "report.json"
    if not path.is_file():
        raise SwingsError("the player wrote no report")
    report: dict[str, Any] = json.loads(path.read_text())
    return report


def played(config: DeliveryConfig, where: str, report: dict[str, Any]) -> Played:
    """The figures of a report; with a capture also the PSNR, predicted and rendered."""
    totals, asked_s = report["totals"], report["plays"][0]["asked_s"]
    predicted_db = rendered_db = None
    if config.capture is not None:
        with open_held_out(config.stream, config.capture) as held_out:
            scores = list(shown_scores(held_out, report, 1))
        predicted_db = fmean(score.predicted_db for score in scores)
        rendered_db = fmean(score.rendered_db for score in scores)
    waited_s = report["frames"][0]["shown_s"] - asked_s + totals["stalled_s"]
    return Played(
        where, totals["mean_layers"], waited_s, totals["stalls"], predicted_db, rendered_db
    )


def without_latency(link: Link) -> Link:
    return Link([LinkStep(step.duration_s, step.rate_bps, 0.0) for step in link.steps])


def for_tbf(link: Link) -> Link:
    """A link that carries the same TCP bytes in a bucket that also counts packet headers."""
    return Link([LinkStep(s.duration_s, s.rate_bps / TCP_SHARE, 0.0) for s in link.steps])


def table_of(case: Case, rows: Sequence[Played], length_s: float) -> Table:
    table = Table(title=f"{case.trace}, load {case.load:g}", box=box.SIMPLE)
    for name in ("", "layers", "waited s", "of the play", "stalls", "predicted dB", "rendered dB"):
        table.add_column(name, justify="right")
    for row in rows:
        predicted, rendered = (
            "" if psnr_db is None else f"{psnr_db:.2f}"
            for psnr_db in (row.predicted_db, row.rendered_db)
        )
        table.add_row(
            row.where, f"{row.layers:.2f}", f"{row.waited_s:.2f}", f"{row.waited_s / length_s:.1%}",
            f"{row.stalls}", predicted, rendered,
        )  # fmt: skip
    return table


def run(config: DeliveryConfig) -> None:
    console = Console()
    reader = StreamReader(config.stream)
    media = open_media(config.stream, reader.num_frames / reader.manifest.fps)
    reason = why_not()
    if reason is not None:
        console.print(f"without tbf: {reason}")
    for load in config.loads:
        for trace in read_traces(config.traces, "all", 1, LATENCY_S):
            case = at_load(trace, load, media)
            level = Case(case.trace, case.load, without_latency(case.link))
            rows = [simulated(media, case)]
            with tempfile.TemporaryDirectory() as folder:
                report = over_relay(config.stream, case.link, Path(folder))
                rows.append(played(config, "emulated link", report))
            if reason is None:
                rows.append(simulated(media, level))
                with tempfile.TemporaryDirectory() as folder:
                    report = over_tbf(config.stream, for_tbf(case.link), Path(folder))
                    rows.append(played(config, "tbf", report))
            console.print(table_of(case, rows, media.length_s))


def main() -> None:
    run_command(
        DeliveryConfig, run, "scripts/bench delivery", "Compares simulated plays with real ones."
    )


if __name__ == "__main__":
    main()
