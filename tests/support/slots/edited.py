"""Streams to edit, and the pictures of their frames."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from codec.camera import Camera
from codec.edit.rewrite import Options, edit_stream
from codec.interop.formats import SplatFormat, write_splats
from codec.sequence.importing import ImportOptions, facing_camera, import_stream
from codec.splats import Splats
from codec.stream import StreamReader, StreamWriter
from codec.stream.writer import Quality
from codec.tools.audit import verify_stream
from player.render.cpu import render_splats
from tests.support.slots.slot_streams import gaussians, slot_manifest
from tests.support.slots.trained_updates import trained_like_layout, trained_like_updates
from tests.support.trained_like import trained_like_splats

NUM_FRAMES, SEGMENT_FRAMES = 14, 6

FrameEdit = Callable[[Splats, int], Splats]
"""Edits the Gaussians of one exported frame, given its number."""


def write_trained_like(
    path: Path, swin_size: int, num_gs: int = 800, quality: Quality | None = None
) -> Path:
    """Writes a finished stream to `path`: NUM_FRAMES frames in segments of SEGMENT_FRAMES."""
    layout = trained_like_layout(num_gs // swin_size, swin_size, SEGMENT_FRAMES)
    with StreamWriter.create(path, slot_manifest(layout), quality=quality) as writer:
        for update in trained_like_updates(layout, NUM_FRAMES, 0.3):
            writer.append(update)
    return path


def write_still(path: Path, num_gs: int = 4000) -> Path:
    """Writes a stream of one frame, in which all Gaussians are new, below `path`."""
    splats = trained_like_splats(num_gs)
    splats = splats.take(np.flatnonzero(np.abs(splats.means).max(axis=1) < 4))
    path.mkdir()
    write_splats(path / "model.ply", splats, SplatFormat.PLY)
    import_stream(path / "model.ply", path / "stream", ImportOptions(fps=30))
    return path / "stream"


def segment_files(stream: Path) -> dict[str, bytes]:
    """The objects of a stream, by path."""
    files = (path for path in (stream / "segments").rglob("*") if path.is_file())
    return {str(path.relative_to(stream)): path.read_bytes() for path in files}


def objects_bytes(stream: Path) -> int:
    return sum(map(len, segment_files(stream).values()))


def frames_of(stream: Path) -> Iterator[Splats]:
    """The active Gaussians of each frame, with all layers."""
    reader = StreamReader(stream)
    for frame in range(reader.num_frames):
        yield reader.active_splats(frame, reader.manifest.num_layers)


def assert_same_frames(source: Path, other: Path) -> None:
    """Asserts that two streams show the same Gaussians, bit by bit, in any order."""
    for before, after in zip(frames_of(source), frames_of(other), strict=True):
        assert gaussians(before) == gaussians(after)


def edited_frames(source: Path, out: Path, options: Options) -> Iterator[tuple[Splats, Splats]]:
    """Edits the stream at `source`; gives the Gaussians of each frame before and after."""
    edit_stream(source, out, options)
    verify_stream(out)
    return zip(frames_of(source), frames_of(out), strict=True)


def overview(stream: Path) -> Camera:
    """A small camera that sees the bounds of a stream."""
    low, high = (np.array(corner) for corner in StreamReader(stream).manifest.bounds)
    return facing_camera(low, high).scaled(0.2)


def least_psnr_db(source: Path, edited: Path, edit: FrameEdit, every: int = 6) -> float:
    """Minimum PSNR of pictures of the `edited` stream against pictures of the frames of `source`
    after `edit`, from an overview and from the stream's own camera."""
    worst = np.inf
    cameras = (overview(edited), StreamReader(edited).manifest.camera())
    pairs = enumerate(zip(frames_of(source), frames_of(edited), strict=True))
    for frame, (exported, found) in pairs:
        if frame % every:
            continue
        for camera in cameras:
            wanted = np.clip(render_splats(edit(exported, frame), camera, 0.01), 0, 1)
            error = np.clip(render_splats(found, camera, 0.01), 0, 1) - wanted
            worst = min(worst, -10 * np.log10(np.mean(error**2) + 1e-12))
    return float(worst)
