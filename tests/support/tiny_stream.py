"""A tiny stream of trained-like Gaussians.

`python -m tests.support.tiny_stream FOLDER FRAMES` writes one as a process to be killed: it creates
or resumes the stream in FOLDER, prints a line when it is about to append, and appends until the
stream has FRAMES frames.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from codec.camera import Camera
from codec.profiles.profile import Profile
from codec.slice import Slice
from codec.stream import StreamWriter
from codec.stream.manifest import Manifest
from tests.support.trained_like import trained_like_slice

SLICE_SIZE = 40


def tiny_manifest(
    profile: Profile = Profile.COMPACT, swin_size: int = 3, segment_frames: int = 4
) -> Manifest:
    return Manifest(
        fps=25.0,
        swin_size=swin_size,
        num_gs=swin_size * SLICE_SIZE,
        layers=(0.5, 0.5),
        segment_frames=segment_frames,
        sh_degree=0,
        profile=profile,
        antialias=False,
        near_m=0.1,
        bounds=((-3.0, -3.0, -3.0), (3.0, 3.0, 3.0)),
        cameras=(Camera("front", 64, 48, 50.0, 50.0, 32.0, 24.0, np.eye(4)),),
        default_camera="front",
        live=True,
        title="tiny",
    )


def tiny_slice(birth: int) -> Slice:
    return trained_like_slice(birth, SLICE_SIZE)


def write_tiny(path: Path, num_frames: int, manifest: Manifest | None = None) -> None:
    """A finished stream of `num_frames` frames at `path`."""
    manifest = tiny_manifest() if manifest is None else manifest
    with StreamWriter.create(path, manifest) as writer:
        for birth in range(manifest.first_birth, num_frames):
            writer.append(tiny_slice(birth))


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
