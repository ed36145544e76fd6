"""Streams of noise, which no coder compresses, with objects and frames of a given size."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from codec.camera import Camera
from codec.lattice.lattice import Lattice
from codec.slice import Slice
from codec.splats import Splats
from codec.stream import StreamWriter
from codec.stream.manifest import Manifest
from codec.stream.wholeslice import split_counts

NUM_LAYERS = 4
FPS = 30.0
GAUSSIAN_BYTES = 54
"""Bytes of a Gaussian with every value as float32 in a packet."""
LATTICE = Lattice(0.01, 1 / 8, 1 / 60, 1 / 20, 41)
"""Unused, because every Gaussian escapes from it."""
OBJECT_FRAMES = 15
"""Frames per segment of a stream that is used for its objects."""


def noise_manifest(slice_size: int, segment_frames: int, live: bool = False) -> Manifest:
    """The manifest of a stream with whole slices of `slice_size` Gaussians in four layers."""
    return Manifest(
        fps=FPS,
        swin_size=1,
        slots=split_counts(slice_size, (1 / NUM_LAYERS,) * NUM_LAYERS),
        lattice=(LATTICE,) * NUM_LAYERS,
        segment_frames=segment_frames,
        sh_degree=0,
        antialias=False,
        near_m=0.01,
        bounds=((-1.0, -1.0, -1.0), (1.0, 1.0, 1.0)),
        cameras=(Camera("front", 64, 48, 50.0, 50.0, 32.0, 24.0, np.eye(4)),),
        default_camera="front",
        live=live,
    )


def slice_size_of(frame_bytes: int) -> int:
    """Gaussians in a slice of about `frame_bytes`."""
    return max(NUM_LAYERS, frame_bytes // GAUSSIAN_BYTES)


def noise_slice(birth: int, slice_size: int) -> Slice:
    rng = np.random.default_rng(birth + 1000)

    def noise(*shape: int) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
        return rng.normal(size=(slice_size, *shape)).astype(np.float32)

    splats = Splats(noise(3), noise(3), noise(4), noise(), noise(1, 3))
    return Slice(birth, splats, np.zeros(slice_size, np.uint8))


def write_noise(path: Path, frame_bytes: int, num_frames: int, segment_frames: int) -> None:
    """Writes a finished stream of about `frame_bytes` per frame with all layers."""
    slice_size = slice_size_of(frame_bytes)
    manifest = noise_manifest(slice_size, segment_frames)
    with StreamWriter.create(path, manifest, exact=True) as writer:
        for birth in range(num_frames):
            writer.append(noise_slice(birth, slice_size))


def write_objects(path: Path, object_bytes: int) -> None:
    """Writes a stream whose objects have about `object_bytes`, except those of segment 0."""
    write_noise(path, NUM_LAYERS * object_bytes // OBJECT_FRAMES, 3 * OBJECT_FRAMES, OBJECT_FRAMES)
