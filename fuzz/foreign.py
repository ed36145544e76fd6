"""Parsers of the formats of others that lie behind a container: what a container checks is made
here, so that the fuzzer reaches what is inside."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from codec.foreign.bundle import Bundle, encode_bundle
from codec.foreign.gltf import decode_gltf
from codec.foreign.gltfbuffers import join_glb
from codec.foreign.ksplat import decode_ksplat
from codec.foreign.sog import META, decode_sog
from codec.foreign.webp import decode_webp, encode_webp
from codec.interop.containers import contained_frames

_NAMES = ("means_l", "means_u", "scales", "quats", "sh0", "shN_centroids", "shN_labels")
PICTURES = tuple(f"{name}.webp" for name in _NAMES)
MAX_PIXELS = 1 << 16
MAX_GAUSSIANS = 1000
MAX_FRAMES = 8
"""Frames read at the beginning of a sequence; its last one is read, too."""


def _json_and_rest(data: bytes) -> tuple[bytes, bytes]:
    """The JSON that the first two bytes give the length of, and what follows."""
    end = 2 + int.from_bytes(data[:2], "little")
    return data[2:end], data[end:]


def fuzz_bundle(data: bytes) -> None:
    """A ZIP archive, of which one file is read."""
    Bundle(data, "ZIP").read(META)


def fuzz_webp(data: bytes) -> None:
    """A picture."""
    height, width, _ = decode_webp(data, "WebP", MAX_PIXELS).shape
    assert height * width <= MAX_PIXELS


def fuzz_inflated_sog(data: bytes) -> None:
    """A SOG of which meta.json and the pixels are given: for each picture which it is, its width
    and its height, a byte each, and its RGBA, filled up with zeros."""
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
    """A .glb of which the JSON and the bytes are given."""
    decode_gltf(join_glb(*_json_and_rest(data)))


def fuzz_ksplat(data: bytes) -> None:
    """A .ksplat file."""
    decode_ksplat(data, MAX_GAUSSIANS)


def fuzz_sequence(data: bytes) -> None:
    """A file that holds a sequence, which its first bytes name: .4dgs, .splat4d."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "sequence"
        path.write_bytes(data)
        frames = contained_frames(path) or []
        for frame in [*frames[:MAX_FRAMES], *frames[-1:]]:
            assert len(frame.read(MAX_GAUSSIANS)) <= MAX_GAUSSIANS
