"""A run that is resumed after its end: nothing is left to train."""

from __future__ import annotations

from rich.console import Console

from codec.stream import StreamReader
from codec.stream.finishing import finish_pictures
from codec.stream.manifest import Manifest
from player.render.cpu import render_splats

from .checkpoint import CHECKPOINT_NAME
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
    checkpoint = config.work_folder / CHECKPOINT_NAME
    if checkpoint.exists():
        for target in run_targets(config):
            finish_pictures(target, render_splats)
        checkpoint.unlink()
    return readers[0].manifest


def show_finished(config: TrainConfig, console: Console) -> None:
    """Prints that the stream of `config` is finished."""
    frames = StreamReader(config.target).num_frames
    console.print(
        f"{config.target} is finished, {frames} frames; nothing is left to train",
        highlight=False, markup=False, soft_wrap=True,
    )  # fmt: skip
