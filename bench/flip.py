"""The visible difference between a stream and its capture: FLIP beside PSNR, over the whole picture
and over its moving pixels.

Usage: scripts/bench flip STREAM CAPTURE [--every N]

FLIP (Andersson et al. 2020; `pip install flip-evaluator`) models a viewer who flips between two
pictures at 67 pixels per degree: 0 is no difference, 1 the largest. The figures are means over the
held-out cameras and the frames, with all layers; moving pixels are those of swings-eval.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from statistics import fmean

import tyro
from flip_evaluator import evaluate
from rich.console import Console
from rich.progress import track
from rich.table import Table

from codec.arrays import Floats
from codec.console import run_command
from trainer.score.scores import Seen, seen_of
from trainer.score.truth import MIN_MOVING_PX, displayed, open_held_out
from trainer.step.loss import psnr_db


@dataclass(frozen=True)
class FlipConfig:
    """Scores a stream's decoded files with FLIP on the held-out cameras of its capture."""

    stream: tyro.conf.Positional[Path]
    """Folder of the stream."""
    capture: tyro.conf.Positional[Path]
    """Folder of the capture that the stream was trained from."""
    every: int = 1
    """Step between scored frames."""


COLUMNS = {"PSNR\ndB": ".2f", "FLIP": ".4f", "moving\ndB": ".2f", "moving\nFLIP": ".4f"}
"""The columns of the table, and how their values are written."""

Scores = list[list[float]]
"""One list for each column, with one value for each picture. Pictures with too few moving pixels
have no value in the moving columns."""


def flip_map(truth: Floats, shown: Floats) -> Floats:
    """(H, W): FLIP of each pixel; both pictures (H, W, 3) in 0..1, sRGB."""
    error: Floats = evaluate(truth, shown, "LDR", applyMagma=False, computeMeanError=False)[0]
    return error.reshape(truth.shape[:2])


def picture_scores(shown: Floats, seen: Seen, camera: int) -> Scores:
    """The scores of one picture against the picture that camera number `camera` captured."""
    truth, mask = seen.truths[camera], seen.masks[camera]
    error = flip_map(truth, shown)
    counting = error if mask is None else error[mask > 0]
    whole = [[psnr_db(shown, truth, mask)], [float(counting.mean())]]
    if not seen.movements or seen.movements[camera].moving < MIN_MOVING_PX:
        return [*whole, [], []]
    pixels = seen.movements[camera].pixels
    return [*whole, [psnr_db(shown, truth, pixels)], [float(error[pixels].mean())]]


def scored(config: FlipConfig) -> dict[str, Scores]:
    """The scores of each held-out camera, by name. Raises the errors of `open_held_out`."""
    with open_held_out(config.stream, config.capture) as held_out:
        reader, manifest = held_out.reader, held_out.reader.manifest
        found: dict[str, Scores] = {c.name: [[] for _ in COLUMNS] for c in held_out.cameras}
        for frame in track(held_out.every(config.every), "FLIP", transient=True):
            seen = seen_of(held_out, frame)
            splats = reader.active_splats(frame, manifest.num_layers)
            for index, camera in enumerate(held_out.cameras):
                shown = displayed(splats, camera, manifest.near_of(camera))
                for column, values in zip(
                    found[camera.name], picture_scores(shown, seen, index), strict=True
                ):
                    column += values
    return found


def table(found: dict[str, Scores]) -> Table:
    """A row for each camera, and one for all pictures."""
    drawn = Table("camera", *COLUMNS)
    every = [list(chain(*column)) for column in zip(*found.values(), strict=True)]
    for name, scores in [*found.items(), ("all", every)]:
        cells = zip(scores, COLUMNS.values(), strict=True)
        drawn.add_row(name, *(format(fmean(v), digits) if v else "-" for v, digits in cells))
    return drawn


def score(config: FlipConfig) -> None:
    Console().print(table(scored(config)))


if __name__ == "__main__":
    run_command(FlipConfig, score, "bench flip", __doc__ or "")
