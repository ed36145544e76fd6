"""Plays of the browser from a static host over traces, in virtual time: its own code in Node.

Usage: scripts/bench hosted --traces DIR [--half report] [--per-folder 9] [--loads 0.6 1 1.8]

They are scored as swings-abr scores plays from a server: same traces, loads, QoE and bound. A
static host sends whole objects of a second each, a server sends packets, so the bound is harder to
reach. The last row is the server's own policy.
"""

from __future__ import annotations

import hashlib
import json
import subprocess
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from bench.abr.bound import normalised
from bench.abr.oracle import Oracle, judge
from codec.camera import Camera
from codec.console import run_command
from codec.lattice.lattice import Lattice
from codec.stream.manifest import Manifest
from codec.stream.segment import SegmentRecord, pack_record
from server.abr.decisioncontext import Send, SendKeyframes, SendSlices
from server.abr.media import SegmentSizes, segment_sizes
from server.study.choice import OWN
from server.study.config import LOADS, Rules
from server.study.looped import LoopedMedia
from server.study.qoe import Qoe, score
from server.study.simulator import Arrival, Simulated, play_out
from server.study.study import Case, at_load, run_play
from server.study.tracefolder import Half, read_traces

FPS = 30.0
SEGMENT_FRAMES = 30
SKIP_MAP_SHARE = 0.05
"""Bytes of the skip maps, as a share of the bytes of layer 0."""
SPREAD = 0.25
"""Maximum deviation of a segment's size from the mean, as a share."""

STREAMS = {
    "basketball": SegmentSizes(
        (17.7e3, 4.3e3, 5.1e3, 7.0e3),
        (27.82, 28.78, 29.25, 29.69),
        (150e3, 75e3, 85e3, 120e3),
        (0.3, 0.15, 0.15, 0.15),
    ),
    "room": SegmentSizes(
        (11.0e3, 8.0e3, 12.0e3, 17.0e3),
        (17.9, 22.4, 26.0, 29.1),
        (90e3, 85e3, 130e3, 190e3),
        (0.3, 0.2, 0.2, 0.2),
    ),
}
"""Bytes of a slice and PSNR by layer: the real scene of docs/RESULTS.md, and a scene whose layers
differ more."""


@dataclass(frozen=True, slots=True)
class HostedConfig:
    """Plays from a static host to simulate."""

    traces: Path
    """Folder of throughput traces; its subfolders count, too."""
    half: Half = "report"
    """Traces to use: tune for the first, third, ... of each folder, by name; report for the other
    half."""
    per_folder: int = 9
    """Maximum number of traces from each folder, evenly spread; 0 for all."""
    loads: tuple[float, ...] = LOADS
    """Ratios of the link's rate to the rate of the stream with all layers."""
    length_s: float = 60.0
    """Seconds of each play."""
    seed: int = 0
    """Seed of the segments' sizes."""


@dataclass(frozen=True, slots=True)
class Scored:
    """One play, and the oracle's bound for it."""

    oracle: Oracle
    qoe: Qoe
    came_bytes: float


def make_records(sizes: SegmentSizes, config: HostedConfig) -> list[SegmentRecord]:
    """An index whose segments have about the sizes that `sizes` gives for a slice."""
    rng = np.random.default_rng(config.seed)
    records = []
    for segment in range(round(config.length_s * FPS / SEGMENT_FRAMES)):
        factor = rng.uniform(1 - SPREAD, 1 + SPREAD)
        layers = [round(factor * SEGMENT_FRAMES * size) for size in sizes.layer_bytes]
        skip_maps = round(SKIP_MAP_SHARE * layers[0])
        layers[0] -= skip_maps
        sides = (skip_maps, *(round(factor * size) for size in sizes.keyframe_bytes))
        sha256 = hashlib.sha256(bytes([segment])).digest()
        records.append(
            SegmentRecord(
                segment,
                segment * SEGMENT_FRAMES,
                SEGMENT_FRAMES,
                tuple(layers),
                (sha256,) * len(layers),
                sizes.psnr_db,
                sides,
                (sha256,) * len(sides),
            )
        )
    return records


def make_manifest(num_layers: int) -> Manifest:
    camera = Camera("c0", 64, 48, 60.0, 60.0, 32.0, 24.0, np.eye(4))
    return Manifest(
        fps=FPS,
        swin_size=1,
        segment_frames=SEGMENT_FRAMES,
        sh_degree=0,
        antialias=False,
        near_m=0.1,
        bounds=((-1.0, -1.0, -1.0), (1.0, 1.0, 1.0)),
        cameras=(camera,),
        default_camera="c0",
        live=False,
        slots=(1,) * num_layers,
        lattice=(Lattice(0.01, 0.125, 1 / 60, 0.056, 161),) * num_layers,
    )


def send_of(segment: int, part: str) -> Send | None:
    """The content of an object; None for the skip maps, which are requested after layer 0."""
    first = segment * SEGMENT_FRAMES
    if part == "skipmaps":
        return None
    if part.startswith("keyframe-"):
        layer = int(part.removeprefix("keyframe-"))
        return SendKeyframes(first, layer, layer + 1)
    return SendSlices(range(first, first + SEGMENT_FRAMES), int(part), int(part) + 1)


def arrivals_of(rows: Sequence[tuple[float, int, int, str]]) -> Iterator[Arrival]:
    """The objects at the times from which they are usable: a layer needs its segment's skip
    maps."""
    skip_maps: set[int] = set()
    waiting: dict[int, list[tuple[float, Send]]] = {}
    for time_s, num_bytes, segment, part in rows:
        send = send_of(segment, part)
        if send is None:
            skip_maps.add(segment)
            for size, held in waiting.pop(segment, []):
                yield Arrival(time_s, size, held)
        elif isinstance(send, SendKeyframes) or segment in skip_maps:
            yield Arrival(time_s, num_bytes, send)
        else:
            waiting.setdefault(segment, []).append((num_bytes, send))


def scored(media: LoopedMedia, result: Simulated, rules: Rules, oracle: Oracle) -> Scored:
    shown, clock = play_out(media, result, rules.session, 0, media.num_frames)
    assert clock.started_s is not None
    assert len(shown) == media.num_frames
    psnr_db = [one.psnr_db for one in shown]
    best_db = media.best_db(range(media.num_frames))
    qoe = score(psnr_db, best_db, FPS, clock.started_s, clock.stalled_s, clock.stalls, rules.qoe)
    return Scored(oracle, qoe, sum(arrival.num_bytes for arrival in result.arrivals))


def by_browser(node: subprocess.Popen[str], question: dict[str, Any]) -> Simulated:
    assert node.stdin is not None
    assert node.stdout is not None
    print(json.dumps(question), file=node.stdin, flush=True)
    rows = json.loads(node.stdout.readline())["arrivals"]
    return Simulated(arrivals=list(arrivals_of(rows)))


def add_row(table: Table, name: str, load: float, who: str, plays: Sequence[Scored]) -> None:
    quality, base, best = (
        fmean(values)
        for values in (
            [play.qoe.quality_db for play in plays],
            [play.oracle.base_db for play in plays],
            [play.oracle.quality_db for play in plays],
        )
    )
    seconds = sum(play.qoe.startup_s + play.qoe.stalled_s for play in plays)
    table.add_row(
        name,
        f"{load:g}",
        who,
        f"{quality:.2f}",
        f"{normalised(quality, base, best):.3f}",
        f"{fmean(play.qoe.psnr_db for play in plays):.2f}",
        f"{seconds / len(plays):.2f}",
        f"{fmean(play.qoe.stalls for play in plays):.2f}",
        f"{fmean(play.qoe.step_db for play in plays):.3f}",
        f"{fmean(play.came_bytes for play in plays) / 1e6:.1f}",
    )


def run(config: HostedConfig) -> None:
    traces = read_traces(config.traces, config.half, config.per_folder, 0.02)
    columns = ("stream", "load", "policy", "QoE dB", "normalised", "PSNR dB", "waited s", "stalls")
    table = Table(*columns, "step dB", "MB", title=f"{len(traces)} traces")
    rules = Rules()
    script = Path(__file__).with_name("hosted.mjs")
    command = ["node", str(script)]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as node:
        for name, sizes in STREAMS.items():
            manifest, records = make_manifest(len(sizes.layer_bytes)), make_records(sizes, config)
            index = b"".join(map(pack_record, records))
            files = {"manifest": manifest.to_json().hex(), "index": index.hex()}
            media = LoopedMedia(
                tuple(segment_sizes(record, manifest) for record in records),
                len(records) * SEGMENT_FRAMES,
                FPS,
                SEGMENT_FRAMES,
            )
            for load in config.loads:
                hosted, served = [], []
                for case in (at_load(trace, load, media) for trace in traces):
                    oracle = judge(media, case, rules)
                    question = {**files, "steps": steps_of(case)}
                    hosted.append(scored(media, by_browser(node, question), rules, oracle))
                    played, _, _ = run_play(media, case, OWN, rules)
                    served.append(scored(media, played, rules, oracle))
                add_row(table, name, load, "browser, whole objects", hosted)
                add_row(table, name, load, "server, packets", served)
    Console().print(table)


def steps_of(case: Case) -> list[tuple[float, float, float]]:
    return [(step.duration_s, step.rate_bps, step.latency_s) for step in case.link.steps]


def main() -> None:
    run_command(HostedConfig, run, "scripts/bench hosted", "Measures plays of a static host.")


if __name__ == "__main__":
    main()
