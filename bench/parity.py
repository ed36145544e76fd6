"""OpenGL beside the CPU renderer on the frames of a trained stream: the smallest PSNR between them.

Usage: scripts/bench parity STREAM
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from codec.console import run_command
from codec.stream import StreamReader
from player.render.cpu import render_splats
from player.render.gl import GlRenderer

FRAMES = 5


@dataclass(frozen=True, slots=True)
class ParityConfig:
    """What to compare."""

    stream: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="STREAM")]]
    """Folder of a stream."""


def run(config: ParityConfig) -> None:
    reader = StreamReader(config.stream)
    manifest = reader.manifest
    worst_db = np.inf
    for frame in np.linspace(0, reader.num_frames - 1, FRAMES).astype(int):
        renderer = GlRenderer(manifest)
        for part in reader.window(int(frame), manifest.num_layers):
            renderer.put(part)
        splats = reader.active_splats(int(frame), manifest.num_layers)
        for camera in manifest.cameras:
            drawn = renderer.render(int(frame), camera).astype(np.float64)
            error = np.mean((drawn - render_splats(splats, camera, manifest.near_m)) ** 2)
            worst_db = min(worst_db, -10 * np.log10(error))
        name = renderer.name
        renderer.close()
    print(f"{name}: {FRAMES} frames x {len(manifest.cameras)} cameras, least {worst_db:.1f} dB")


def main() -> None:
    run_command(ParityConfig, run, "scripts/bench parity", "Compares OpenGL with the CPU renderer.")


if __name__ == "__main__":
    main()
