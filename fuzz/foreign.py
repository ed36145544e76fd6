"""Targets for foreign formats inside a container: the targets build valid containers, so that the
fuzzer reaches the parsers of their contents."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from codec.foreign.gltf import decode_gltf, join_glb
from codec.foreign.ksplat import decode_ksplat
from codec.foreign.sog import META, Bundle, decode_sog, encode_bundle
from codec.foreign.webp import decode_webp, encode_webp
from codec.interop.formats import contained_frames

_NAMES = ("means_l", "means_u", "scales", "quats", "sh0", "shN_centroids", "shN_labels")
PICTURES = tuple(f"{name}.webp" for name in _NAMES)
MAX_PIXELS = 1 << 16
MAX_GAUSSIANS = 1000
MAX_FRAMES = 8
"""Number of frames read at the beginning of a sequence; its last frame is read, too."""


def _json_and_rest(data: bytes) -> tuple[bytes, bytes]:
    """The JSON, whose length the first two bytes give, and the bytes after it."""
    end = 2 + int.from_bytes(data[:2], "little")
    return data[2:end], data[end:]


def fuzz_bundle(data: bytes) -> None:
    """A ZIP archive; one file of it is read."""
    Bundle(data, "ZIP").read(META)


def fuzz_webp(data: bytes) -> None:
    """A picture."""
    height, width, _ = decode_webp(data, "WebP", MAX_PIXELS).shape
    assert height * width <= MAX_PIXELS


def fuzz_inflated_sog(data: bytes) -> None:
    """A SOG from given meta.json and pixels. For each picture, the input has its number, width and
    height, a byte each, and its RGBA, which is padded with zeros."""
    meta, rest = _json_and_rest(data)
    files = {META: meta}
    while len(rest) >= 3:
        number, width, height = rest[0] % len(PICTURES), max(rest[1], 1), max(rest[2], 1)
        pixels = rest[3 : 3 + 4 * width * height].ljust(4 * width * height, b"\0")
        rest = rest[3 + 4 * width * height :]
        table = np.frombuffer(pixels, np.uint8).reshape(height, width, 4)
        files[PICTURES[number]] = encode_webp(table)
    decode_sog(encode_bundle(files))


def fuzz_inflated_glb(data: bytes) -> None:
    """A .glb from a given JSON and given bytes."""
    decode_gltf(join_glb(*_json_and_rest(data)))


def fuzz_ksplat(data: bytes) -> None:
    """A .ksplat file."""
    decode_ksplat(data, MAX_GAUSSIANS)


def fuzz_sequence(data: bytes) -> None:
    """A .tsog file."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.tsog"
        path.write_bytes(data)
        frames = contained_frames(path) or []
        for frame in [*frames[:MAX_FRAMES], *frames[-1:]]:
            assert len(frame.read(MAX_GAUSSIANS)) <= MAX_GAUSSIANS
