"""Pictures as tables of bytes: WebP without loss, of which the header is read before all else.

Source: RFC 9649. A file is a RIFF container whose first chunk holds the size: VP8L (lossless) by
itself, or VP8X (the extended layout).
"""

from __future__ import annotations

import io
import struct

import numpy as np
from PIL import Image

from codec.arrays import Bytes
from codec.errors import CorruptError, UnsupportedError

RIFF = struct.Struct("<4sI4s4sI")
LOSSLESS, EXTENDED = b"VP8L", b"VP8X"
LOSSLESS_SIGNATURE = 0x2F
ANIMATED = 2
"""Flag of the extended layout."""
MAX_SIDE_PX = 1 << 14
EFFORT = 4
"""Pillow's method, of 0 to 6: the last two take three times as long for 1 %."""


def webp_size(data: bytes, what: str) -> tuple[int, int]:
    """Width and height in pixels of the WebP file `data`.

    Raises CorruptError, or UnsupportedError for a picture of another format, with loss, or moving.
    """
    if len(data) < RIFF.size + 10 or data[:4] != b"RIFF":
        raise UnsupportedError(f"{what}: is not a WebP picture")
    _, _, form, kind, _ = RIFF.unpack_from(data)
    body = data[RIFF.size : RIFF.size + 10]
    if form != b"WEBP" or kind not in (LOSSLESS, EXTENDED):
        raise UnsupportedError(f"{what}: is not a WebP picture without loss")
    if kind == LOSSLESS:
        if body[0] != LOSSLESS_SIGNATURE:
            raise CorruptError(f"{what}: the WebP picture has no signature")
        bits = int.from_bytes(body[1:5], "little")
        width, height = (bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1
    else:
        if body[0] & ANIMATED:
            raise UnsupportedError(f"{what}: is a moving picture")
        width = int.from_bytes(body[4:7], "little") + 1
        height = int.from_bytes(body[7:10], "little") + 1
    if max(width, height) > MAX_SIDE_PX:
        raise CorruptError(f"{what}: {width} x {height} pixels, at most {MAX_SIDE_PX} a side")
    return width, height


def decode_webp(data: bytes, what: str, max_pixels: int) -> Bytes:
    """(height, width, 4) bytes, RGBA.

    Raises CorruptError, also for more than `max_pixels`, of which nothing is decoded; or
    UnsupportedError.
    """
    width, height = webp_size(data, what)
    if width * height > max_pixels:
        raise CorruptError(f"{what}: {width} x {height} pixels, at most {max_pixels} in all")
    try:
        with Image.open(io.BytesIO(data), formats=["WEBP"]) as picture:
            if picture.size != (width, height):
                raise CorruptError(f"{what}: the picture is not {width} x {height}")
            return np.asarray(picture.convert("RGBA"))
    except (OSError, ValueError, SyntaxError, EOFError, RuntimeError, MemoryError) as error:
        raise CorruptError(f"{what}: the WebP picture is broken") from error


def encode_webp(pixels: Bytes) -> bytes:
    """The file of a (height, width, 3 or 4) picture, every byte of it kept."""
    file = io.BytesIO()
    # exact: else the colour of what is transparent is lost.
    Image.fromarray(pixels).save(file, "WEBP", lossless=True, exact=True, method=EFFORT)
    return file.getvalue()
