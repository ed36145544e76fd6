"""The poster, a still picture of a stream for people who have not opened it yet; and the
storyboard, small pictures of a finished stream in one file, which a player shows while a viewer
searches for a moment.
"""

from __future__ import annotations

import io
import math
from dataclasses import dataclass

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
    before: a training writes it with its first segment, and again when the stream is finished.
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


STORYBOARD_NAME = "storyboard.webp"
"""Name of the file that `write_storyboard` writes."""

MAX_TILES = 60
TILES_PER_S = 4
"""Tiles of a second of the stream, at most."""
COLUMNS = 10
TILE_PX = 160
"""Longer side of a tile."""

AIM_BYTES = 150_000
QUALITIES = (70, 50, 30, 15, 5, 0)
"""WebP qualities: the first one that gives AIM_BYTES or less is taken. Noise of the largest size at
the last one stays below MAX_PICTURE_BYTES."""


@dataclass(frozen=True, slots=True)
class StoryboardLayout:
    """Where the tiles lie: row by row, each tile `step_frames` after the one before."""

    step_frames: int
    num_tiles: int
    columns: int
    rows: int

    @staticmethod
    def of(num_frames: int, fps: float) -> StoryboardLayout:
        """The layout for a stream of this length, of at least one frame."""
        step = max(math.ceil(fps / TILES_PER_S), math.ceil(num_frames / MAX_TILES))
        num_tiles = math.ceil(num_frames / step)
        columns = min(COLUMNS, num_tiles)
        return StoryboardLayout(step, num_tiles, columns, math.ceil(num_tiles / columns))


def write_storyboard(stream: Target, draw: Draw) -> None:
    """Puts a storyboard beside a stream whose last frame is there and whose manifest names
    STORYBOARD_NAME; else, or without a frame, nothing.

    Its tiles show what the default camera sees, decoded with all layers: MAX_TILES pictures are
    drawn at most, however long the stream is. It is whole or absent, and replaces the one before.
    """
    reader = StreamReader(stream, max_gaussians=None)
    manifest = reader.manifest
    if manifest.storyboard != STORYBOARD_NAME or not reader.num_frames:
        return
    layout = StoryboardLayout.of(reader.num_frames, manifest.fps)
    camera = manifest.camera()
    scale = min(1.0, TILE_PX / max(camera.width_px, camera.height_px))
    width_px, height_px = (max(1, round(px * scale)) for px in (camera.width_px, camera.height_px))
    # Drawn twice as large where the camera is: small Gaussians are drawn at least a pixel wide.
    drawn_camera = camera.scaled(min(1.0, 2 * scale))
    near_m = manifest.near_of(camera)
    sheet = Image.new("RGB", (layout.columns * width_px, layout.rows * height_px))
    for tile in range(layout.num_tiles):
        splats = reader.active_splats(tile * layout.step_frames, manifest.num_layers)
        picture = Image.fromarray(pixels_of(draw(splats, drawn_camera, near_m)))
        row, column = divmod(tile, layout.columns)
        tile_picture = picture.resize((width_px, height_px), Image.Resampling.BOX)
        sheet.paste(tile_picture, (column * width_px, row * height_px))
    open_growing(stream, SHAPE).put(STORYBOARD_NAME, _encoded(sheet))


def _encoded(sheet: Image.Image) -> bytes:
    """`sheet` as WebP, of AIM_BYTES at most if some quality gives that."""
    content = b""
    for quality in QUALITIES:
        data = io.BytesIO()
        sheet.save(data, "WEBP", quality=quality, method=4)
        content = data.getvalue()
        if len(content) <= AIM_BYTES:
            break
    return content
