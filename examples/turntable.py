"""Draws one frame from all sides, into a video or as PNGs into a folder. Needs no GPU, no screen.

python examples/turntable.py demo/stream 30 turntable.mp4
"""

import math
import sys
from pathlib import Path

from codec.framerange import FrameRange
from player import Scene
from player.show.sink import open_sink, to_bytes
from player.view.path import Size, orbit

PICTURES = 24
FPS = 12

source, frame, out = sys.argv[1], int(sys.argv[2]), Path(sys.argv[3])
with Scene.open(source, renderer="cpu") as scene:
    start = scene.camera().resized(320, 180)
    camera_of = orbit(scene.manifest, start, FrameRange(0, PICTURES), 2 * math.pi)
    with open_sink(out, FPS, Size(start.width_px, start.height_px)) as sink:
        for number in range(PICTURES):
            sink.write(number, to_bytes(scene.render(frame, camera_of(number))))
print(f"{PICTURES} pictures of frame {frame}: {out}")
