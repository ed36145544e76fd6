"""Seeds of fuzz/foreign.py, written by fuzz/seed.py."""

from __future__ import annotations

import io
import json
from collections.abc import Iterator

import numpy as np
from PIL import Image

from codec.foreign.gltf import encode_glb, encode_gltf, join_glb, split_glb
from codec.foreign.ksplat import HEADER, HEADER_BYTES, SECTION, SECTION_BYTES
from codec.foreign.sog import META, Bundle, encode_bundle, encode_sog
from codec.foreign.spz import encode_spz
from codec.foreign.tsog import encode_tsog
from codec.splats import Splats

from .foreign import PICTURES


def _with_length(text: bytes) -> bytes:
    return len(text).to_bytes(2, "little") + text


def inflated_sog(data: bytes) -> bytes:
    """A SOG with its pictures as pixels, and with short codebooks, to keep the corpus small."""
    bundle = Bundle(data, "SOG")
    meta = json.loads(bundle.read(META))
    for name in ("scales", "sh0", "shN"):
        if name in meta:
            meta[name]["codebook"] = [i % 10 for i in range(256)]
    food = _with_length(json.dumps(meta, separators=(",", ":")).encode())
    present = [name for name in PICTURES if "shN" in meta or not name.startswith("shN")]
    for name in present:
        with Image.open(io.BytesIO(bundle.read(name))) as picture:
            food += bytes([PICTURES.index(name), picture.width, picture.height])
            food += picture.convert("RGBA").tobytes()
    return food


def inflated_glb(data: bytes) -> bytes:
    text, chunk = split_glb(data)
    return _with_length(text.strip()) + bytes(chunk)


def placed_glb(data: bytes) -> bytes:
    """`data` under nodes that turn, mirror, move and scale it."""
    text, chunk = split_glb(data)
    root = json.loads(text)
    root["nodes"] = [
        {"children": [1], "rotation": [0, 0.6, 0, 0.8], "translation": [1, 2, 3]},
        {"mesh": 0, "matrix": [0, 2, 0, 0, 2, 0, 0, 0, 0, 0, 2, 0, 0, 0, 0, 1]},
    ]
    return join_glb(json.dumps(root, separators=(",", ":")).encode(), bytes(chunk))


def spz_glb(splats: Splats) -> bytes:
    """An SPZ file in a .glb, as in drafts of an extension."""
    packed = encode_spz(splats)
    about = {"extensions": {"KHR_gaussian_splatting_compression_spz_2": {"bufferView": 0}}}
    primitive = {"mode": 0, "attributes": {}, "extensions": {"KHR_gaussian_splatting": about}}
    root = {
        "asset": {"version": "2.0"},
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [primitive]}],
        "bufferViews": [{"buffer": 0, "byteLength": len(packed)}],
        "buffers": [{"byteLength": len(packed)}],
    }
    return join_glb(json.dumps(root, separators=(",", ":")).encode(), packed)


def signalling_glb(splats: Splats) -> bytes:
    """A .glb with a signalling NaN as an opacity, of which numpy warns."""
    opacities = splats.opacities.tobytes()
    return encode_glb(splats).replace(opacities, b"\1\0\xa0\x7f" + opacities[4:])


def ksplat() -> bytes:
    """Three Gaussians of level 1, two in a full bucket and one in a partial one."""
    fields = [("centre", "<u2", 3), ("scale", "<f2", 3), ("rot", "<f2", 4), ("rgba", "u1", 4)]
    records = np.zeros(3, fields)
    records["centre"] = [[32767, 32767, 32767], [0, 32767, 65534], [32767, 0, 32767]]
    records["scale"], records["rot"][:, 0], records["rgba"] = 0.5, 1, 200
    head = HEADER.pack(0, 1, 1, 1, 3, 3, 1, 0, 0).ljust(HEADER_BYTES, b"\0")
    section = SECTION.pack(3, 3, 2, 2, 5, 12, 0, 1, 1, 0).ljust(SECTION_BYTES, b"\0")
    before = np.array([1], "<u4").tobytes() + np.array([1, 2, 3, -9, 0, 9], "<f4").tobytes()
    return head + section + before + records.tobytes()


def foreign_seeds(plain: Splats, degree_1: Splats) -> Iterator[tuple[str, str, bytes]]:
    """(target, name, input) of every file; each gives a value. degree_1: of SH degree 1."""
    for number, splats in enumerate((plain, degree_1)):
        yield "inflated_sog", str(number), inflated_sog(encode_sog(splats))
        yield "inflated_glb", str(number), inflated_glb(encode_glb(splats))
    yield "import", "sog", encode_sog(plain)
    yield "import", "glb", encode_glb(plain)
    yield "import", "gltf", encode_gltf(plain)
    yield "inflated_glb", "placed", inflated_glb(placed_glb(encode_glb(degree_1)))
    yield "inflated_glb", "spz", inflated_glb(spz_glb(plain))
    yield "bundle", "two", encode_bundle({META: b"{}", "a": b"b"})
    yield "webp", "quats", Bundle(encode_sog(plain), "SOG").read("quats.webp")
    yield "ksplat", "buckets", ksplat()
    yield "sequence", "tsog", encode_tsog([plain, plain], 25.0)
