"""A tiny stream of trained-like Gaussians.

`python -m tests.support.tiny_stream FOLDER FRAMES` writes one, as a process for tests to kill. It
creates or resumes the stream in FOLDER, prints a line before each append, and appends until the
stream has FRAMES frames.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from codec.lattice.lattice import Lattice
from codec.slice import Slice
from codec.slots.slotlayout import SlotLayout
from codec.stream import StreamWriter
from codec.stream.manifest import Manifest
from tests.support.slots.folder import slots_manifest
from tests.support.trained_like import trained_like_slice

SLICE_SIZE = 40
SWIN_SIZE = 3


def tiny_manifest(swin_size: int = SWIN_SIZE, segment_frames: int = 4) -> Manifest:
    counts = (SLICE_SIZE // 2, SLICE_SIZE - SLICE_SIZE // 2)
    lattice = Lattice.suiting(tiny_slice(0).splats)
    layout = SlotLayout(swin_size, counts, 0, (lattice,) * 2, segment_frames)
    return replace(slots_manifest(layout), title="tiny")


def tiny_slice(birth: int, swin_size: int = SWIN_SIZE) -> Slice:
    """A whole slice; all its Gaussians start within `swin_size` frames."""
    slice = trained_like_slice(birth, SLICE_SIZE)
    return replace(slice, start_offsets=np.minimum(slice.start_offsets, swin_size - 1))


def write_tiny(
    path: Path, num_frames: int, manifest: Manifest | None = None, exact: bool = False
) -> None:
    """Writes a finished stream of `num_frames` frames to `path`."""
    manifest = tiny_manifest() if manifest is None else manifest
    with StreamWriter.create(path, manifest, exact=exact) as writer:
        for birth in range(manifest.first_birth, num_frames):
            writer.append(tiny_slice(birth, manifest.swin_size))


def append_tiny(writer: StreamWriter, num_frames: int) -> None:
    """Appends the slices of the stream of `write_tiny` that `writer` does not have yet."""
    for birth in range(writer.next_birth, num_frames):
        writer.append(tiny_slice(birth))


def files_of(stream: Path) -> dict[str, bytes]:
    """The files of a stream without leftovers, which a reader ignores."""
    found = (p for p in stream.rglob("*") if p.is_file() and not p.name.startswith("."))
    return {str(p.relative_to(stream)): p.read_bytes() for p in found}


def main() -> None:
    path, num_frames = Path(sys.argv[1]), int(sys.argv[2])
    if (path / "manifest.json").exists():
        writer = StreamWriter.resume(path)
    else:
        writer = StreamWriter.create(path, tiny_manifest())
    with writer:
        for birth in range(writer.next_birth, num_frames):
            sys.stdout.write(f"{birth}\n")
            sys.stdout.flush()
            writer.append(tiny_slice(birth))


if __name__ == "__main__":
    main()
