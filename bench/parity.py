"""OpenGL 3.3 and 4.3 compared with the CPU renderer on frames of a stream: PSNR, and the pixel with
the largest difference.

Usage: scripts/bench parity STREAM
"""

from __future__ import annotations

from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from rich.console import Console

from codec.console import run_command
from codec.stream import StreamReader
from player.render.cpu import render_splats
from player.render.gl import GlError, GlRenderer
from player.render.renderer import GlVersion

FRAMES = 5


@dataclass(frozen=True, slots=True)
class ParityConfig:
    """The stream to compare."""

    stream: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="STREAM")]]
    """Folder of a stream."""


def compare(reader: StreamReader, version: GlVersion) -> str:
    """The figures of one way of drawing, as a line of text. Raises GlError."""
    manifest = reader.manifest
    psnrs_db, worst = [], (0.0, "nowhere")
    frames = np.unique(np.linspace(0, reader.num_frames - 1, FRAMES).astype(int)).tolist()
    for frame in frames:
        with closing(GlRenderer(manifest, version=version)) as renderer:
            for part in reader.window(frame, manifest.num_layers):
                renderer.put(part)
            splats = reader.active_splats(frame, manifest.num_layers)
            for camera in manifest.cameras:
                drawn = renderer.render(frame, camera).astype(np.float64)
                expected = render_splats(splats, camera, manifest.near_of(camera))
                difference = np.abs(drawn - expected)
                psnrs_db.append(-10 * np.log10(np.mean(difference**2)))
                y, x, _ = np.unravel_index(int(difference.argmax()), difference.shape)
                where = f"frame {frame}, {camera.name}, pixel ({x}, {y})"
                worst = max(worst, (float(difference.max()) * 255, where))
            name = renderer.name
    return (
        f"{name}: {len(frames)} frames x {len(manifest.cameras)} cameras, "
        f"PSNR {min(psnrs_db):.1f} dB at least, {np.median(psnrs_db):.1f} in the middle; "
        f"at most {worst[0]:.1f} levels off ({worst[1]})"
    )


def run(config: ParityConfig) -> None:
    reader = StreamReader(config.stream)
    for version in (GlVersion.V33, GlVersion.V43):
        try:
            print(compare(reader, version))
        except GlError as error:
            Console(stderr=True).print(f"no GL {version}: {error}")


def main() -> None:
    run_command(ParityConfig, run, "scripts/bench parity", "Compares OpenGL with the CPU renderer.")


if __name__ == "__main__":
    main()
