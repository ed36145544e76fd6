"""Rate against quality of a stream with and without a temporal layer.

Usage: scripts/bench temporal STREAM CAPTURE

Writes the stream again, with the same Gaussians in every frame and a temporal layer of each period,
and scores all streams on the held-out cameras with 1, 2, ... layers, as swings-eval does. The last
layer of a stream with a period is the temporal layer. The row before it is the same stream without
that layer: in the frames left out, Gaussians that go on are interpolated.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

os.environ.setdefault("OMP_WAIT_POLICY", "passive")

import tyro
from rich import box
from rich.console import Console
from rich.table import Table

from codec.console import run_command
from codec.tools.cutting import set_temporal_layer
from trainer.score.evaluate import EvaluateConfig, LayerScore, evaluate_stream


@dataclass(frozen=True, slots=True)
class TemporalConfig:
    """Scores a stream with and without a temporal layer."""

    stream: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="STREAM")]
    """Folder of the stream, with a swin_size of 1."""
    capture: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="CAPTURE")]
    """Folder of the capture that the stream was trained from."""
    periods: tuple[int, ...] = (2, 4)
    """Periods of the temporal layers."""
    every: int = 1
    """Score every n-th frame."""


def scored(stream: Path, config: TemporalConfig) -> list[LayerScore]:
    """The scores of a stream with 1, 2, ... layers."""
    made = evaluate_stream(EvaluateConfig(stream, config.capture, every=config.every))
    return made.layers


def run(config: TemporalConfig) -> None:
    table = Table(box=box.MARKDOWN)
    for name in ("period", "layers", "kB a frame", "PSNR, dB", "moving pixels, dB"):
        table.add_column(name, justify="right")
    with TemporaryDirectory() as folder:
        for period in (1, *config.periods):
            stream = config.stream
            if period > 1:
                stream = Path(folder) / f"period-{period}"
                set_temporal_layer(config.stream, stream, period)
            rows = scored(stream, config)
            for number, row in enumerate(rows, start=1):
                temporal = " with the temporal one" if period > 1 and number == len(rows) else ""
                moving = "-" if row.moving_psnr_db is None else f"{row.moving_psnr_db:.2f}"
                table.add_row(
                    "-" if period == 1 else str(period),
                    f"{number}{temporal}",
                    f"{row.bytes_per_frame / 1e3:.2f}",
                    f"{row.psnr_db:.2f}",
                    moving,
                )
    Console(width=120).print(table)


if __name__ == "__main__":
    description = "Rate against quality of a stream with and without a temporal layer."
    run_command(TemporalConfig, run, "scripts/bench temporal", description)
