"""OpenGL beside the CPU renderer on the frames of a trained stream: the smallest PSNR between them.

Usage: scripts/bench parity STREAM
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from codec.stream import StreamReader
from player.render.cpu import render_splats
from player.render.gl import GlRenderer

FRAMES = 5


def main() -> None:
    reader = StreamReader(Path(sys.argv[1]))
    manifest = reader.manifest
    worst = np.inf
    for frame in np.linspace(0, reader.num_frames - 1, FRAMES).astype(int):
        renderer = GlRenderer(manifest)
        for part in reader.window(int(frame), manifest.num_layers):
            renderer.put(part)
        splats = reader.active_splats(int(frame), manifest.num_layers)
        for camera in manifest.cameras:
            drawn = renderer.render(int(frame), camera).astype(np.float64)
            error = np.mean((drawn - render_splats(splats, camera, manifest.near_m)) ** 2)
            worst = min(worst, -10 * np.log10(error))
        name = renderer.name
        renderer.close()
    print(f"{name}: {FRAMES} frames x {len(manifest.cameras)} cameras, least {worst:.1f} dB")


if __name__ == "__main__":
    main()
