"""Quality that a player actually showed, beside the quality in the index: the frames of a play's
report are rendered for the held-out cameras and scored.

Usage: scripts/bench shown STREAM --report REPORT.json --capture CAPTURE

REPORT.json is the report that `swings-play --report` wrote for a play of STREAM. It lists the
packets that had arrived when each frame was shown. The player's own assembler assembles exactly
these packets. "predicted" is the PSNR in the index for the layers that these packets form; the
server decides by it.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean
from typing import Annotated, Any

os.environ.setdefault("OMP_WAIT_POLICY", "passive")

import tyro
from rich import box
from rich.console import Console
from rich.table import Table

from codec.console import run_command
from codec.errors import CodecError, InvalidError
from codec.stream import StreamReader
from codec.stream.manifest import SKIP_MAPS, Part, keyframe_part
from player.playout.assembler import Assembler
from player.render.cpu import CpuRenderer
from player.source.source import KeyframePackets, Packets, SlicePackets
from server.abr.holding import Holding
from server.study.looped import open_media
from trainer.score.truth import ScoredCameras, captured, on_screen, open_held_out, score_picture


@dataclass(frozen=True, slots=True)
class ShownConfig:
    """The play to score."""

    stream: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="STREAM")]]
    """Folder of the stream."""
    report: Path
    """Report of the play, written by `swings-play --report`."""
    capture: Path
    """The capture that the stream was trained from."""
    every: int = 1
    """Score every n-th frame."""


@dataclass(frozen=True, slots=True)
class ShownScore:
    """The scores of a shown frame."""

    frame: int
    layers: float
    predicted_db: float
    rendered_db: float
    """Mean over the held-out cameras."""


def blame(error: CodecError, part: Part) -> CodecError:
    return error


def packets_of(reader: StreamReader, arrival: dict[str, Any]) -> Packets:
    """The packets of one arrival."""
    layers = range(arrival["first_layer"], arrival["first_layer"] + arrival["layers"])
    birth, frame = arrival["birth"], arrival["keyframe_frame"]

    def packet(at: int, part: Part) -> bytes:
        return reader.read_object(reader.manifest.segment_of(at), part).packet(at)

    if birth is None:
        keyframes = tuple(packet(frame, keyframe_part(layer)) for layer in layers)
        return KeyframePackets(frame, layers.start, keyframes, blame)
    skip_map = None if layers.start else packet(birth, SKIP_MAPS)
    return SlicePackets(
        birth, layers.start, tuple(packet(birth, layer) for layer in layers), skip_map, blame
    )


def shown_scores(
    held_out: ScoredCameras, report: dict[str, Any], every: int
) -> Iterator[ShownScore]:
    """Scores the frames of the first play of a report."""
    reader, manifest = held_out.reader, held_out.reader.manifest
    frames = [frame for frame in report["frames"] if frame["play"] == 0]
    arrivals = [arrival for arrival in report["arrivals"] if arrival["play"] == 0]
    if not frames or any(report["dropped"].values()):
        raise InvalidError("the report lacks part of the play; play a shorter time")
    first = frames[0]["frame"]
    media = open_media(Path(reader.name), reader.num_frames / manifest.fps)
    holding = Holding(media, first)
    assembler = Assembler(manifest, manifest.num_layers, first)
    renderer = CpuRenderer(manifest)
    waiting = [(arrival["came_s"], packets_of(reader, arrival)) for arrival in arrivals]
    for shown in frames:
        frame, shown_s = shown["frame"], shown["shown_s"]
        used = [one for time_s, one in waiting if time_s <= shown_s and one.first_frame <= frame]
        waiting = [
            (time_s, one) for time_s, one in waiting if time_s > shown_s or one.first_frame > frame
        ]
        for one in used:
            one.add_to(holding)
        for part in assembler.assemble(frame, used):
            renderer.put(part)
        if (frame - first) % every == 0:
            scores = []
            for camera, shot in zip(held_out.cameras, held_out.shots(frame), strict=True):
                picture = on_screen(renderer.render(frame, camera))
                scores.append(score_picture(picture, captured(shot.picture), shot.mask).psnr_db)
            yield ShownScore(frame, holding.layers(frame), holding.psnr_db(frame), fmean(scores))
        holding.forget(frame)


def table_of(scores: list[ShownScore]) -> Table:
    """A row for each number of shown layers, and one for all frames."""
    table = Table(box=box.SIMPLE)
    for name in ("layers", "frames", "predicted dB", "rendered dB", "difference"):
        table.add_column(name, justify="right")
    by_layers: dict[str, list[ShownScore]] = {}
    for score in scores:
        by_layers.setdefault(f"{round(score.layers)}", []).append(score)
    for name, some in [*sorted(by_layers.items()), ("all", scores)]:
        predicted = fmean(score.predicted_db for score in some)
        rendered = fmean(score.rendered_db for score in some)
        table.add_row(
            name, f"{len(some)}", f"{predicted:.2f}", f"{rendered:.2f}",
            f"{rendered - predicted:+.2f}",
        )  # fmt: skip
    return table


def run(config: ShownConfig) -> None:
    report = json.loads(config.report.read_text())
    with open_held_out(config.stream, config.capture) as held_out:
        scores = list(shown_scores(held_out, report, config.every))
    Console().print(table_of(scores))


def main() -> None:
    run_command(
        ShownConfig, run, "scripts/bench shown", "Scores the frames that a player really showed."
    )


if __name__ == "__main__":
    main()
