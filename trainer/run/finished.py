"""The end of a run: what was made of it, and one that is resumed after its end."""

from __future__ import annotations

import shlex

from rich.console import Console

from codec.progressline import clock
from codec.stream import StreamReader
from codec.stream.finishing import finish_pictures
from codec.stream.manifest import Manifest
from codec.tools.audit import layer_summaries
from player.render.cpu import render_splats

from .checkpoint import CHECKPOINT_NAME, forget_run
from .config import TrainConfig
from .outputs import has_manifest, run_targets


def finish_outputs(config: TrainConfig) -> Manifest | None:
    """The manifest of a run whose streams are all finished; None for any other run.

    A run that was killed after its last frame may have left its checkpoint, and not the last
    poster and the storyboard: all are put right. Raises CodecError for a manifest that cannot be
    read.
    """
    readers = []
    for target in run_targets(config):
        if not has_manifest(target):
            return None
        reader = StreamReader(target)
        if reader.manifest.live:
            return None
        readers.append(reader)
    if (config.work_folder / CHECKPOINT_NAME).exists():
        for target in run_targets(config):
            finish_pictures(target, render_splats)
        forget_run(config.work_folder)
    return readers[0].manifest


def show_result(config: TrainConfig, took_s: float, console: Console) -> None:
    """Prints quality and size of a stream that was finished now, and what to do with it. took_s:
    time of this run, seconds."""
    reader = StreamReader(config.target)
    whole = layer_summaries(reader)[-1]
    figures = [f"{reader.num_frames} frames"]
    if whole.psnr_db is not None:
        figures.append(f"{whole.psnr_db:.2f} dB")
    figures.append(f"{whole.size_bytes / reader.num_frames / 1e3:.1f} kB a frame")
    figures.append(f"{whole.bitrate_bps / 1e6:.2f} Mbit/s")
    stream, capture = (shlex.quote(str(place)) for place in (config.target, config.capture))
    for line in (
        f"{config.target}: {', '.join(figures)}; this run took {clock(took_s)}",
        f"to watch it: swings-serve {stream}",
        f"to score it: swings-eval {stream} {capture} --sheet sheet.png",
    ):
        console.print(line, highlight=False, markup=False, soft_wrap=True)


def show_finished(config: TrainConfig, console: Console) -> None:
    """Prints that the stream of `config` is finished."""
    frames = StreamReader(config.target).num_frames
    console.print(
        f"{config.target} is finished, {frames} frames; nothing is left to train",
        highlight=False, markup=False, soft_wrap=True,
    )  # fmt: skip
