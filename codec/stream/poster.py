"""The poster: a still picture of a stream, for people who have not opened it yet.

No frame needs it, so no figure of a stream's bytes counts it. Nothing in codec draws: whoever wants
a poster hands in a renderer.
"""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path

import numpy as np
import numpy.typing as npt
from PIL import Image

from codec.camera import Camera
from codec.errors import CorruptError
from codec.splats import Splats
from codec.storage.opengrowing import open_growing
from codec.storage.openstorage import Place, Target, open_storage

from .manifest import Manifest
from .reader import StreamReader
from .writer import SHAPE

POSTER_NAME = "poster.jpg"
"""What the poster is called that `write_poster` writes."""

MAX_PICTURE_BYTES = 1 << 20
"""Largest poster that is written, served or exported."""

MAX_WIDTH_PX, MAX_HEIGHT_PX, QUALITY = 640, 1280, 85
"""Of a poster that is written. Even noise of this size and JPEG quality keeps the bound."""

PICTURE_TYPES = {
    ".jpg": "image/jpeg",
    ".jpeg": "image/jpeg",
    ".png": "image/png",
    ".webp": "image/webp",
}
"""What a poster's name may end in, and the media type of its content. None of them can hold a
script, as SVG can."""

MAGICS = {"image/jpeg": b"\xff\xd8\xff", "image/png": b"\x89PNG\r\n\x1a\n", "image/webp": b"RIFF"}

Floats = npt.NDArray[np.float32]

Draw = Callable[[Splats, Camera, float], Floats]
"""A renderer: (H, W, 3) in 0..1, perhaps above, of Gaussians, a camera and the nearest depth in
metres."""


def picture_type(name: str) -> str | None:
    """The media type of the picture called `name`; None for what cannot be a poster."""
    return PICTURE_TYPES.get(Path(name).suffix.lower())


def poster_path(manifest: Manifest) -> str | None:
    """The path of the poster that `manifest` names; None unless it is a picture's, in the stream's
    folder: one that begins with `//` would lead a browser to another host."""
    path = manifest.poster or ""
    if picture_type(path) is None or {"", ".."} & set(path.split("/")):
        return None
    return path


def find_poster(place: Place, manifest: Manifest) -> str | None:
    """The path of the poster that `manifest` names, if it is a picture of the stream at `place`."""
    path = poster_path(manifest)
    return path if path is not None and open_storage(place).holds(path) else None


def read_poster(place: Place, manifest: Manifest) -> bytes | None:
    """The content of `find_poster`; None if that is too large. Raises CorruptError if it cannot be
    read."""
    storage, path = open_storage(place), find_poster(place, manifest)
    stamp = None if path is None else storage.stamp(path)
    if path is None or stamp is None or stamp.size_bytes > MAX_PICTURE_BYTES:
        return None
    return storage.read(path, MAX_PICTURE_BYTES)


def check_poster(place: Place, manifest: Manifest) -> None:
    """Raises CorruptError, with the file, if there is a poster that is too large, or of another
    kind than its name says. A stream may go without the poster that it names."""
    storage, path = open_storage(place), find_poster(place, manifest)
    stamp = None if path is None else storage.stamp(path)
    if path is None or stamp is None:
        return
    name = storage.place(path)
    if stamp.size_bytes > MAX_PICTURE_BYTES:
        raise CorruptError(
            f"{name}: {stamp.size_bytes} bytes; a poster has at most {MAX_PICTURE_BYTES}"
        )
    kind = picture_type(path)
    if kind is not None and not storage.read(path, MAX_PICTURE_BYTES).startswith(MAGICS[kind]):
        raise CorruptError(f"{name}: does not begin as {kind} does")


def write_poster(stream: Target, draw: Draw) -> None:
    """Puts a poster beside a stream whose manifest names POSTER_NAME; else, or before
    its first frame, nothing.

    It shows what the default camera sees of the frame in the middle of what there is by now,
    decoded with all layers. It is whole or absent, and replaces the one before.
    """
    reader = StreamReader(stream, max_gaussians=None)
    manifest = reader.manifest
    if manifest.poster != POSTER_NAME or not reader.num_frames:
        return
    splats = reader.active_splats(reader.num_frames // 2, manifest.num_layers)
    camera = manifest.camera()
    scale = min(1.0, MAX_WIDTH_PX / camera.width_px, MAX_HEIGHT_PX / camera.height_px)
    sides_px = (max(1, round(camera.width_px * scale)), max(1, round(camera.height_px * scale)))
    # Drawn twice as large where the camera is: small Gaussians are drawn at least a pixel wide.
    drawn = draw(splats, camera.scaled(min(1.0, 2 * scale)), manifest.near_m)
    picture = Image.fromarray(np.rint(np.clip(drawn, 0, 1) * 255).astype(np.uint8))
    data = io.BytesIO()
    picture.resize(sides_px, Image.Resampling.BOX).save(
        data, "JPEG", quality=QUALITY, optimize=True, progressive=True
    )
    open_growing(stream, SHAPE).put(POSTER_NAME, data.getvalue())
