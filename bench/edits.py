"""Bytes of a stream after an edit, as a share of the bytes before, and PSNR against the same edit
made on the exported frames.

Usage: scripts/bench edits [--gs N] [--frames F] [--model FILE]
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from codec.console import run_command
from codec.edit.cut import join_streams, trim_stream
from codec.edit.rewrite import edit_stream
from codec.edit.transform import TransformOptions
from codec.errors import InvalidError
from codec.framerange import FrameRange
from codec.interop.formats import SplatFormat, write_splats
from codec.sequence.importing import ImportOptions, import_stream
from codec.splats import Splats
from codec.stream import StreamReader, StreamWriter
from codec.stream.manifest import keyframe_part
from tests.support.slots.edited import FrameEdit, least_psnr_db, objects_bytes
from tests.support.slots.slot_streams import slot_manifest
from tests.support.slots.trained_updates import trained_like_layout, trained_like_updates
from tests.support.trained_like import trained_like_splats

EDITS = {
    "transform --move 1 2 3": TransformOptions(move=(1, 2, 3)),
    "transform --turn 90 0 0": TransformOptions(turn=(90, 0, 0)),
    "transform --turn 10 20 30 --move 1 2 3": TransformOptions(turn=(10, 20, 30), move=(1, 2, 3)),
}
ROOM_M = 4.0
ACTIVE = 0.3
"""Share of the slots that a slice of a sequence changes."""


@dataclass(frozen=True, slots=True)
class EditsConfig:
    """Edits a still model and sequences, and tabulates their bytes."""

    gs: int = 50_000
    """Gaussians of a frame of the sequences, and of the still model unless a file is given."""
    frames: int = 60
    """Frames of the sequences."""
    segment_frames: int = 30
    """Frames of a segment."""
    model: Path | None = None
    """File of the still model; without it, one is generated."""

    def __post_init__(self) -> None:
        if self.gs < 100 or self.frames < 2 * self.segment_frames:
            raise InvalidError("choose at least 100 Gaussians and two segments")


def still_model(count: int) -> Splats:
    """A generated model without the Gaussians far outside its room."""
    splats = trained_like_splats(count)
    return splats.take(np.flatnonzero(np.abs(splats.means).max(axis=1) < ROOM_M))


def imported(config: EditsConfig, root: Path) -> Path:
    """The still model as a stream."""
    model = config.model or root / "model.ply"
    if config.model is None:
        write_splats(model, still_model(config.gs), SplatFormat.PLY)
    import_stream(model, root / "still", ImportOptions(fps=30.0))
    return root / "still"


def sequence(config: EditsConfig, root: Path, swin_size: int) -> Path:
    """A stream whose slots last."""
    path = root / f"sequence{swin_size}"
    layout = trained_like_layout(config.gs // swin_size, swin_size, config.segment_frames)
    with StreamWriter.create(path, slot_manifest(layout)) as writer:
        for update in trained_like_updates(layout, config.frames, ACTIVE):
            writer.append(update)
    return path


def on_frames(options: TransformOptions) -> FrameEdit:
    """The edit that `options` describe, as a function of one exported frame."""
    similarity = options.similarity()
    return lambda splats, _: similarity.moved(splats)


def edited(sources: list[Path], root: Path) -> Iterator[list[str]]:
    """Rows of the edits of each stream."""
    for words, options in EDITS.items():
        row = [f"`{words}`"]
        for source in sources:
            out = root / f"{source.name} {words}"
            edit_stream(source, out, options)
            share = objects_bytes(out) / objects_bytes(source)
            dB = least_psnr_db(source, out, on_frames(options), 1 << 30)
            row += [f"{100 * share:.2f} %", f"{dB:.1f}"]
        yield row


def joined(source: Path, config: EditsConfig, root: Path) -> Iterator[list[str]]:
    """Rows of joins of a stream's first half with its second half, and with another scene."""
    half = config.frames // 2 // config.segment_frames * config.segment_frames
    first, second, other = (root / f"{source.name} {name}" for name in ("1st half", "2nd", "other"))
    trim_stream(source, first, FrameRange(0, half))
    trim_stream(source, second, FrameRange(half))
    edit_stream(second, other, TransformOptions(turn=(90, 0, 0)))  # no Gaussian is where it was
    for following in (second, other):
        made = join_streams([first, following], root / f"joined {following.name}")
        reader = StreamReader(following)
        parts = map(keyframe_part, range(reader.manifest.num_layers))
        state_bytes = sum(len(reader.read_object(0, part).data) for part in parts)
        yield [
            f"{source.name}, {following.name.removeprefix(source.name)}",
            f"{made.source_bytes:,}",
            f"{100 * made.size_bytes / made.source_bytes:.2f} %",
            f"{made.size_bytes - made.source_bytes:,}",
            f"{state_bytes:,}",
        ]


def run(config: EditsConfig) -> None:
    console = Console(width=150)
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        sources = [imported(config, root), *(sequence(config, root, n) for n in (1, 5))]
        table = Table(box=box.MARKDOWN)
        table.add_column("edit", no_wrap=True)
        for source in sources:
            table.add_column(f"{source.name}, {objects_bytes(source):,} bytes", justify="right")
            table.add_column("dB", justify="right")
        for row in edited(sources, root):
            table.add_row(*row)
        console.print(table)
        table = Table(
            "join with", "bytes before", "after", "seam, bytes", "state, bytes", box=box.MARKDOWN
        )
        for source in sources[1:]:
            for row in joined(source, config, root):
                table.add_row(*row)
        console.print(table)


if __name__ == "__main__":
    run_command(EditsConfig, run, "scripts/bench edits", "Measures the bytes that edits leave.")
