"""Pictures as tables of bytes, and claims of their headers."""

from __future__ import annotations

import io
import struct

import numpy as np
import pytest
from PIL import Image

from codec.errors import CodecError, CorruptError, UnsupportedError
from codec.foreign.levels import Bytes
from codec.foreign.webp import decode_webp, encode_webp, webp_size


def noise(*shape: int) -> Bytes:
    return np.random.default_rng(7).integers(0, 256, shape).astype(np.uint8)


@pytest.mark.parametrize("channels", [3, 4])
def test_every_byte_comes_back_also_of_what_is_transparent(channels: int) -> None:
    pixels = noise(5, 7, channels)
    if channels == 4:
        pixels[:3, :, 3] = 0
    data = encode_webp(pixels)
    assert webp_size(data, "it") == (7, 5)
    back = decode_webp(data, "it", 35)
    assert (back[..., :channels] == pixels).all()
    assert back.shape == (5, 7, 4)


def test_the_extended_layout_is_read() -> None:
    file = io.BytesIO()
    Image.fromarray(noise(4, 6, 3)).save(file, "WEBP", lossless=True, exif=b"Exif\0\0MM\0*")
    data = file.getvalue()
    assert data[12:16] == b"VP8X"
    assert webp_size(data, "it") == (6, 4)
    assert (decode_webp(data, "it", 24)[..., :3] == noise(4, 6, 3)).all()


def saved(format: str, **options: object) -> bytes:
    file = io.BytesIO()
    Image.fromarray(noise(4, 4, 3)).save(file, format, **options)
    return file.getvalue()


MOVING = saved(
    "WEBP", save_all=True, lossless=True, append_images=[Image.fromarray(noise(4, 4, 4)[..., :3])]
)


@pytest.mark.parametrize(
    ("data", "kind", "says"),
    [
        (b"", UnsupportedError, "it: is not a WebP"),
        (saved("PNG"), UnsupportedError, "is not a WebP"),
        (saved("WEBP"), UnsupportedError, "without loss"),
        (MOVING, UnsupportedError, "moving"),
        (encode_webp(noise(4, 4, 3))[:30], CorruptError, "broken"),
        (encode_webp(noise(3, 6, 3)), CorruptError, "6 x 3 pixels, at most 16"),
    ],
)
def test_another_picture_is_refused(data: bytes, kind: type[CodecError], says: str) -> None:
    with pytest.raises(kind, match=says):
        decode_webp(data, "it", 16)


def test_a_side_that_no_decoder_takes_is_refused() -> None:
    head = b"RIFF" + struct.pack("<I", 100) + b"WEBPVP8X" + struct.pack("<I4x", 10)
    wide = head + b"\xff\xff\xff" + b"\0\0\0" + bytes(60)
    with pytest.raises(CorruptError, match="16777216 x 1 pixels"):
        decode_webp(wide, "it", 1 << 40)
