"""A run that is resumed after its end: nothing is left to train."""

from __future__ import annotations

from rich.console import Console

from codec.storage.opengrowing import open_growing
from codec.stream import StreamReader
from codec.stream.manifest import MANIFEST_NAME, Manifest
from codec.stream.poster import write_poster
from codec.stream.writer import SHAPE
from player.render.cpu import render_splats

from .checkpoint import CHECKPOINT_NAME
from .config import TrainConfig
from .outputs import run_targets


def finish_outputs(config: TrainConfig) -> Manifest | None:
    """The manifest of a run whose streams are all finished; None for any other run.

    A run that was killed after its last frame may have left its checkpoint, and not the last
    poster: both are put right. Raises CodecError for a manifest that cannot be read.
    """
    readers = []
    for target in run_targets(config):
        if MANIFEST_NAME not in open_growing(target, SHAPE).names():
            return None
        reader = StreamReader(target)
        if reader.manifest.live:
            return None
        readers.append(reader)
    checkpoint = config.work_folder / CHECKPOINT_NAME
    if checkpoint.exists():
        for target in run_targets(config):
            write_poster(target, render_splats)
        checkpoint.unlink()
    return readers[0].manifest


def show_finished(config: TrainConfig, console: Console) -> None:
    """Prints that the stream of `config` is finished."""
    frames = StreamReader(config.target).num_frames
    console.print(
        f"{config.target} is finished, {frames} frames; nothing is left to train",
        highlight=False, markup=False, soft_wrap=True,
    )  # fmt: skip
