"""Quality of pictures between two frames of a stream: held, faded and interpolated.

Usage: scripts/bench between STREAM [--capture CAPTURE]

First table: a frame is drawn from two other frames, equally far before and after it, and compared
with the stream's own picture of it. Held: the earlier frame is shown again. Faded: the mean of both
pictures. Interpolated: slots that go on move, all others fade (codec/slice.py).

Second table, with --capture: the same against the pictures of the held-out cameras, as if every
second frame had not been sent.

Changing pixels are those of trainer/score/truth.py: they differ from the held frame (first table)
or from the frame before (second table).
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from codec.arrays import Floats

os.environ.setdefault("OMP_WAIT_POLICY", "passive")

import numpy as np
import tyro
from rich import box
from rich.console import Console
from rich.table import Table

from codec.camera import Camera
from codec.console import run_command
from codec.errors import InvalidError
from codec.stream import StreamReader
from player.show.sink import to_bytes
from trainer.pictures.scale import Shot
from trainer.score.truth import Movement, captured, displayed, movement_of, open_held_out
from trainer.step.loss import psnr_db

HELD, FADED, INTERPOLATED, SENT = "held", "faded", "interpolated", "sent"
"""Ways to make a picture between two frames. SENT is the stream's own frame."""


@dataclass(frozen=True, slots=True)
class BetweenConfig:
    """Scores pictures between the frames of a stream."""

    stream: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="STREAM")]
    """Folder of the stream."""
    capture: Path | None = None
    """Folder of the capture that the stream was trained from, for the second table."""
    gaps: tuple[int, ...] = (2, 4, 8)
    """Distances between the two frames that a picture is drawn from, even numbers of frames."""
    cameras: int = 2
    """Cameras of the first table, spread evenly over the stream's cameras."""
    pictures: int = 10
    """Frames of the first table, spread evenly over the stream."""


@dataclass(slots=True)
class Scores:
    """PSNR of each picture in dB, by the way it was made."""

    whole: dict[str, list[float]] = field(default_factory=dict)
    changing: dict[str, list[float]] = field(default_factory=dict)
    changing_share: list[float] = field(default_factory=list)
    goes_on: list[float] = field(default_factory=list)
    """Share of the Gaussians of a frame that go on from the frame before it."""

    def add(self, shown: dict[str, Floats], truth: Floats, movement: Movement) -> None:
        self.changing_share.append(movement.moving / movement.counting)
        for how, picture in shown.items():
            self.whole.setdefault(how, []).append(psnr_db(picture, truth))
            changing_db = movement.psnr_db(picture, truth)
            if changing_db is not None:
                self.changing.setdefault(how, []).append(changing_db)


def drawn_between(
    reader: StreamReader, frame: int, gap: int, cameras: list[Camera], scores: Scores
) -> Iterator[dict[str, Floats]]:
    """For each camera, the pictures of `frame`, made in each way from the two frames around it that
    are `gap` apart."""
    manifest, layers = reader.manifest, reader.manifest.num_layers
    first, last = frame - gap // 2, frame + gap // 2
    motion = reader.motion(first, last, layers)
    scores.goes_on.append(1 - float(motion.enters.mean()))
    before, halfway = reader.active_splats(first, layers), motion.all_at(0.5)
    for camera in cameras:
        near_m = manifest.near_of(camera)
        held, there = (
            displayed(splats, camera, near_m)
            for splats in (before, reader.active_splats(last, layers))
        )
        yield {
            HELD: held,
            FADED: (held + there) / np.float32(2),
            INTERPOLATED: displayed(halfway, camera, near_m),
        }


def against_stream(reader: StreamReader, gap: int, config: BetweenConfig) -> Scores:
    """The first table's row of `gap`."""
    if gap < 2 or gap % 2:
        raise InvalidError(f"gap {gap}: choose an even number of frames")
    places = np.linspace(gap // 2, reader.num_frames - 1 - gap // 2, config.pictures)
    if places[-1] < places[0]:
        raise InvalidError(f"{reader.name} has {reader.num_frames} frames, too few for gap {gap}")
    known = reader.manifest.cameras
    picked = np.linspace(0, len(known) - 1, min(config.cameras, len(known)) + 2)[1:-1]
    cameras = [known[round(n)] for n in picked]
    scores = Scores()
    for frame in np.unique(np.rint(places).astype(int)).tolist():
        true = reader.active_splats(frame, reader.manifest.num_layers)
        shown = drawn_between(reader, frame, gap, cameras, scores)
        for camera, pictures in zip(cameras, shown, strict=True):
            truth = displayed(true, camera, reader.manifest.near_of(camera))
            movement = movement_of(
                Shot(to_bytes(pictures[HELD]), None), Shot(to_bytes(truth), None)
            )
            scores.add(pictures, truth, movement)
    return scores


def against_film(config: BetweenConfig) -> Scores:
    """The second table."""
    assert config.capture is not None
    scores = Scores()
    with open_held_out(config.stream, config.capture) as held_out:
        reader, cameras = held_out.reader, held_out.cameras
        for frame in range(1, reader.num_frames - 1, 2):
            sent = reader.active_splats(frame, reader.manifest.num_layers)
            shown = drawn_between(reader, frame, 2, cameras, scores)
            shots = zip(held_out.shots(frame - 1), held_out.shots(frame), strict=True)
            for camera, pictures, (before, now) in zip(cameras, shown, shots, strict=True):
                pictures[SENT] = displayed(sent, camera, reader.manifest.near_of(camera))
                scores.add(pictures, captured(now.picture), movement_of(before, now))
    return scores


def table_of(title: str, rows: dict[str, Scores], methods: tuple[str, ...]) -> Table:
    """A row for each of `rows`; whole pictures first, then changing pixels."""
    table = Table(box=box.MARKDOWN, title=title)
    table.add_column("apart")
    for where in ("", "changing: "):
        for how in methods:
            table.add_column(f"{where}{how}, dB", justify="right")
    table.add_column("changing pixels", justify="right")
    table.add_column("slots that go on", justify="right")
    for name, scores in rows.items():
        texts = [
            f"{np.mean(by[how]):.2f}" if by.get(how) else "-"
            for by in (scores.whole, scores.changing)
            for how in methods
        ]
        shares = f"{np.mean(scores.changing_share):.1%}", f"{np.mean(scores.goes_on):.1%}"
        table.add_row(name, *texts, *shares)
    return table


def run(config: BetweenConfig) -> None:
    console = Console(width=160)
    reader = StreamReader(config.stream)
    rows = {f"{gap} frames": against_stream(reader, gap, config) for gap in config.gaps}
    methods = HELD, FADED, INTERPOLATED
    console.print(table_of("against the stream's own frames", rows, methods))
    if config.capture is not None:
        film = {"2 frames": against_film(config)}
        console.print(table_of("against the film", film, (SENT, *methods)))


if __name__ == "__main__":
    description = "Scores pictures between the frames of a stream."
    run_command(BetweenConfig, run, "scripts/bench between", description)
