"""The pictures beside a stream that its manifest names: the poster and the storyboard.

No frame needs them, so no figure of a stream's bytes counts them. Nothing in codec draws: the
caller passes a renderer.
"""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path

import numpy as np
from PIL import Image

from codec.arrays import Bytes, Floats
from codec.camera import Camera
from codec.errors import CorruptError
from codec.splats import Splats
from codec.storage.openstorage import Place, open_storage

from .manifest import Manifest

MAX_PICTURE_BYTES = 1 << 20
"""Largest picture that is written, served or exported."""

PICTURE_TYPES = {
    ".jpg": "image/jpeg",
    ".jpeg": "image/jpeg",
    ".png": "image/png",
    ".webp": "image/webp",
}
"""Accepted suffixes of a picture's name, and the media type of each. None of them can hold a
script, as SVG can."""

MAGICS = {"image/jpeg": b"\xff\xd8\xff", "image/png": b"\x89PNG\r\n\x1a\n", "image/webp": b"RIFF"}


Draw = Callable[[Splats, Camera, float], Floats]
"""A renderer: (H, W, 3) in 0..1, perhaps above, of Gaussians, a camera and the nearest depth in
metres."""


def picture_type(name: str) -> str | None:
    """The media type of the picture called `name`; None for what cannot be one."""
    return PICTURE_TYPES.get(Path(name).suffix.lower())


def picture_path(path: str | None) -> str | None:
    """`path`; None unless it is a picture's, in the stream's folder: one that begins with `//`
    would lead a browser to another host."""
    if path is None or picture_type(path) is None or {"", ".."} & set(path.split("/")):
        return None
    return path


def find_picture(place: Place, path: str | None) -> str | None:
    """`path`, if a picture of the stream at `place` lies there."""
    found = picture_path(path)
    return found if found is not None and open_storage(place).holds(found) else None


def read_picture(place: Place, path: str | None) -> bytes | None:
    """The content of `find_picture`; None if that is too large. Raises CorruptError if it cannot
    be read."""
    storage, found = open_storage(place), find_picture(place, path)
    stamp = None if found is None else storage.stamp(found)
    if found is None or stamp is None or stamp.size_bytes > MAX_PICTURE_BYTES:
        return None
    return storage.read(found, MAX_PICTURE_BYTES)


def picture_size_px(data: bytes) -> tuple[int, int] | None:
    """Width and height by the header of a picture; None if it is none of PICTURE_TYPES, or far too
    large."""
    try:
        with Image.open(io.BytesIO(data), formats=("JPEG", "PNG", "WEBP")) as picture:
            return picture.size
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError):
        return None


def check_pictures(place: Place, manifest: Manifest) -> None:
    """Raises CorruptError, with the file, if a picture that `manifest` names is too large, or of
    another kind than its name says. A stream may go without the pictures that it names."""
    for path, what in ((manifest.poster, "poster"), (manifest.storyboard, "storyboard")):
        storage, found = open_storage(place), find_picture(place, path)
        stamp = None if found is None else storage.stamp(found)
        if found is None or stamp is None:
            continue
        name = storage.place(found)
        if stamp.size_bytes > MAX_PICTURE_BYTES:
            raise CorruptError(
                f"{name}: {stamp.size_bytes} bytes; a {what} has at most {MAX_PICTURE_BYTES}"
            )
        kind = picture_type(found)
        magic = MAGICS[kind] if kind is not None else b""
        if not storage.read(found, MAX_PICTURE_BYTES).startswith(magic):
            raise CorruptError(f"{name}: does not begin as {kind} does")


def pixels_of(drawn: Floats) -> Bytes:
    """A renderer's picture, values 0 to 1, as 8-bit pixels."""
    return np.rint(np.clip(drawn, 0, 1) * 255).astype(np.uint8)
