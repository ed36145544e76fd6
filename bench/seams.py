"""A capture trained in parts, compared with the same frames trained in one go: the seams.

Usage: scripts/bench seams CAPTURE --work FOLDER [--frames A:B] [--part-frames N] ...

Both streams are trained with the same settings and scored from their files on the held-out cameras,
with all layers. Parts are trained one after the other, as workers would train them. Rows named by
frames are the first five frames of a part. "flicker in seams over elsewhere" is the flicker of the
frames in which a part takes over from the previous part, relative to that of all other frames.
Trained streams stay in the work folder and are not trained again.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from pathlib import Path

from codec.arrays import Doubles, Floats

os.environ.setdefault("OMP_WAIT_POLICY", "passive")

import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

from codec.console import run_command
from codec.stream import StreamReader
from trainer.parts.joiner import Joiner
from trainer.parts.raydriver import plan
from trainer.parts.task import Kind, Run, TaskQueue
from trainer.parts.worker import opened_worker
from trainer.run.config import PRESETS, TrainConfig
from trainer.run.job import train_stream
from trainer.run.prepare import prepare
from trainer.run.warm import start_over_if_compiled
from trainer.score.scores import STILL
from trainer.score.truth import ScoredCameras, captured, displayed, open_held_out, score_picture

AFTER_FRAMES = 5
"""Frames of a part that have a row of their own."""


@dataclass(frozen=True)
class SeamsConfig:
    """Trains a capture in one go and in parts, and compares the pictures."""

    capture: tyro.conf.Positional[Path]
    """Folder of the recording."""
    work: Path
    """Folder for both streams."""
    frames: str = ":"
    """Frames of the capture to train, A:B."""
    part_frames: int = 45
    """Frames of a part."""
    warm_frames: int = 30
    """Warm-up frames before a part."""
    seam_frames: int = 30
    """Frames of the seam, in which a part takes over."""
    num_gs: int = 5_000
    """Gaussians active in a frame."""
    genesis_iterations: int = 1_200
    """Iterations of the first window."""
    settle_rounds: int = 6
    """Settle rounds of the first window."""
    window_iterations: int = 200
    """Iterations of every later window."""

    def training(self, stream: Path) -> TrainConfig:
        """The settings of a run into `stream`."""
        base = PRESETS["cpu"](capture=self.capture, stream=stream)
        fit = replace(
            base.fit,
            num_gs=self.num_gs,
            genesis_iterations=self.genesis_iterations,
            settle_rounds=self.settle_rounds,
            window_iterations=self.window_iterations,
        )
        return replace(
            base,
            frames=self.frames,
            part_frames=self.part_frames,
            warm_frames=self.warm_frames,
            seam_frames=self.seam_frames,
            snapshot_every=0,
            fit=fit,
        )


@dataclass(frozen=True, slots=True)
class Seen:
    """Scores of a stream, frame by frame."""

    psnr_db: Doubles  # (F,) mean over the cameras
    flicker: Doubles  # (F,) change of still pixels since the frame before, in %


def seen_of(held_out: ScoredCameras) -> Seen:
    """Scores the pictures of a stream."""
    manifest, psnr_db, flicker = held_out.reader.manifest, [], [np.nan]
    before: dict[int, tuple[Floats, Floats]] = {}
    for frame in range(held_out.reader.num_frames):
        splats = held_out.reader.active_splats(frame, manifest.num_layers)
        scores, change, count = [], 0.0, 0
        for number, camera in enumerate(held_out.cameras):
            truth = captured(held_out.shot(number, frame).picture)
            shown = displayed(splats, camera, manifest.near_of(camera))
            scores.append(score_picture(shown, truth, None).psnr_db)
            if number in before:
                shown_before, truth_before = before[number]
                still = np.abs(truth - truth_before).max(axis=2) <= STILL
                change += float(np.abs(shown - shown_before)[still].sum())
                count += 3 * int(still.sum())
            before[number] = shown, truth
        psnr_db.append(float(np.mean(scores)))
        if frame:
            flicker.append(100 * change / max(count, 1))
    return Seen(np.array(psnr_db), np.array(flicker))


def train_parts(run: Run, console: Console) -> None:
    """Trains all parts, one after the other."""
    joiner, queue = Joiner(run), TaskQueue(run, lambda task: False)
    while (task := queue.take()) is not None:
        with console.status(task.name), opened_worker(task, lambda iterations: None) as worker:
            worker.work()
        queue.done(task)
        if task.kind is Kind.GENESIS:
            joiner.begin(resumed=False)
        for _ in joiner.go_on():
            pass
    joiner.finish()


def compare(config: SeamsConfig) -> None:
    console = Console()
    one, many = config.work / "one", config.work / "many"
    start_over_if_compiled(config.training(one).fit.sh_degree, console)
    config.work.mkdir(parents=True, exist_ok=True)
    if not one.exists():
        train_stream(config.training(one), Console(stderr=True))
    training = config.training(many)
    run = plan(training, prepare(training))
    if not many.exists():
        train_parts(run, console)
    found = []
    for stream in (one, many):
        with console.status(f"rendering {stream}"), open_held_out(stream, config.capture) as seen:
            found.append(seen_of(seen))
    show(console, run, *found)
    sizes = [sum(r.played_bytes for r in StreamReader(s).records) / 1000 for s in (one, many)]
    frames = len(found[0].psnr_db)
    console.print(
        f"kB a frame: {sizes[0] / frames:.1f} in one go, {sizes[1] / frames:.1f} in parts"
    )


def show(console: Console, run: Run, one: Seen, many: Seen) -> None:
    """Prints the differences."""
    in_seams = np.zeros(len(one.psnr_db), np.bool_)
    for part in run.parts[1:]:
        in_seams[part.first_frame : part.first_frame + run.seam_frames + 1] = True
    table = Table("frames", "one go dB", "parts dB", "differ dB", "flicker, one go", "parts")
    first = [part.first_frame for part in run.parts[1:]]
    rows = [("all", np.arange(len(in_seams))), ("seams", np.flatnonzero(in_seams))]
    rows += [(f"{f} to {f + 4}", np.arange(f, f + AFTER_FRAMES)) for f in first]
    for name, frames in rows:
        a, b = one.psnr_db[frames], many.psnr_db[frames]
        each = "" if len(frames) > AFTER_FRAMES else "  " + " ".join(f"{d:+.2f}" for d in b - a)
        table.add_row(
            name, f"{a.mean():.2f}", f"{b.mean():.2f}", f"{(b - a).mean():+.2f}{each}",
            f"{np.nanmean(one.flicker[frames]):.3f}", f"{np.nanmean(many.flicker[frames]):.3f}",
        )  # fmt: skip
    console.print(table)
    elsewhere = np.nanmean(many.flicker[~in_seams])
    console.print(
        f"flicker in seams over elsewhere: {np.mean(many.flicker[in_seams]) / elsewhere:.2f}; "
        f"the worst frame {many.flicker[in_seams].max() / elsewhere:.2f}; "
        f"in one go {np.mean(one.flicker[in_seams]) / np.nanmean(one.flicker[~in_seams]):.2f}"
    )


if __name__ == "__main__":
    run_command(SeamsConfig, compare, "bench seams", __doc__ or "")
