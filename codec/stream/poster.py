"""The poster: a still picture of a stream, for people who have not opened it yet."""

from __future__ import annotations

import io

from PIL import Image

from codec.splats import Splats
from codec.storage.openstorage import Target, open_growing

from .manifest import Manifest
from .pictures import Draw, pixels_of
from .reader import StreamReader
from .writer import SHAPE

POSTER_NAME = "poster.jpg"
"""File name of the poster that `write_poster` writes."""

MAX_WIDTH_PX, MAX_HEIGHT_PX, QUALITY = 640, 1280, 85
"""Largest size of a written poster, and its JPEG quality: even noise stays below
MAX_PICTURE_BYTES."""


def write_poster(stream: Target, draw: Draw) -> None:
    """Puts a poster beside a stream whose manifest names POSTER_NAME; else, or before
    its first frame, nothing.

    It shows what the default camera sees of the frame with which players start, decoded with all
    layers: frame 0, or the newest of a live stream. It is whole or absent, and replaces the one
    before.
    """
    reader = StreamReader(stream, max_gaussians=None)
    manifest = reader.manifest
    if manifest.poster != POSTER_NAME or not reader.num_frames:
        return
    frame = reader.num_frames - 1 if manifest.live else 0
    put_poster(stream, manifest, reader.active_splats(frame, manifest.num_layers), draw)


def put_poster(stream: Target, manifest: Manifest, splats: Splats, draw: Draw) -> None:
    """Puts a poster that shows `splats` beside a stream."""
    camera = manifest.camera()
    scale = min(1.0, MAX_WIDTH_PX / camera.width_px, MAX_HEIGHT_PX / camera.height_px)
    sides_px = (max(1, round(camera.width_px * scale)), max(1, round(camera.height_px * scale)))
    # Drawn twice as large where the camera is: small Gaussians are drawn at least a pixel wide.
    drawn = draw(splats, camera.scaled(min(1.0, 2 * scale)), manifest.near_of(camera))
    data = io.BytesIO()
    Image.fromarray(pixels_of(drawn)).resize(sides_px, Image.Resampling.BOX).save(
        data, "JPEG", quality=QUALITY, optimize=True, progressive=True
    )
    open_growing(stream, SHAPE).put(POSTER_NAME, data.getvalue())
