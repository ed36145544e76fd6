"""Writes the small files of fuzz/corpus from the project's own encoders: `python -m fuzz.seed`."""

from __future__ import annotations

import gzip
import math
import struct
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import zstandard

from codec.arrays import Floats
from codec.camera import Camera
from codec.coders.zstd import compress
from codec.foreign.ply import encode_ply
from codec.foreign.splat import encode_splat
from codec.foreign.spz import ENTRY, HEADER_V4, MAGIC, SpzVersion, encode_spz
from codec.splats import Splats, sh_count
from codec.stream.manifest import Manifest
from codec.stream.packedlayout import PackedHead, PackedLayout
from codec.stream.playrecord import (
    EndRecord,
    ErrorRecord,
    KeyframeRecord,
    Record,
    SliceRecord,
    StartRecord,
    encode_record,
)
from codec.stream.segment import SegmentRecord, pack_record

from .codec import TARGETS
from .foreignseed import foreign_seeds, signalling_glb
from .slots import LAYOUTS
from .slotseed import slot_seeds

CORPUS = Path(__file__).parent / "corpus"


def made_splats(count: int, sh_degree: int) -> Splats:
    """`count` random Gaussians; one lies far away, so that it escapes."""
    rng = np.random.default_rng(count)
    means = rng.normal(size=(count, 3))
    means[-1:] *= 1e4

    def floats(*shape: int) -> Floats:
        return rng.normal(size=shape).astype(np.float32)

    return Splats(
        means.astype(np.float32),
        floats(count, 3) - 4,
        floats(count, 4),
        floats(count),
        floats(count, sh_count(sh_degree), 3),
    )


def made_manifest() -> Manifest:
    layout = LAYOUTS[0]
    return Manifest(
        fps=30.0,
        swin_size=layout.swin_size,
        slots=layout.slots,
        lattice=layout.lattices,
        segment_frames=layout.segment_frames,
        sh_degree=layout.sh_degree,
        antialias=False,
        near_m=0.1,
        bounds=((-1.0, -1.0, -1.0), (1.0, 1.0, 1.0)),
        cameras=(Camera("front", 64, 48, 50.0, 50.0, 32.0, 24.0, np.eye(4)),),
        default_camera="front",
        live=True,
    )


def compressed_ply(count: int, rest: int) -> bytes:
    """A compressed PLY of random words within unit bounds."""
    rng = np.random.default_rng(rest)
    chunks = -(-count // 256)
    ends = [f"{end}_{axis}" for end in ("min", "max") for axis in ("x", "y", "z")]
    ends += [f"{end}_scale_{axis}" for end in ("min", "max") for axis in ("x", "y", "z")]
    packed = [f"packed_{name}" for name in ("position", "rotation", "scale", "color")]
    lines = ["ply", "format binary_little_endian 1.0", f"element chunk {chunks}"]
    lines += [f"property float {end}" for end in ends]
    lines += [f"element vertex {count}", *(f"property uint {name}" for name in packed)]
    if rest:
        lines += [f"element sh {count}", *(f"property uchar f_rest_{i}" for i in range(rest))]
    bounds = np.tile(np.repeat((-1.0, 1.0), 3), 2).astype("<f4")
    words = rng.integers(0, 1 << 32, (count, 4)).astype("<u4")
    harmonics = rng.integers(0, 256, (count, rest)).astype(np.uint8)
    head = "\n".join([*lines, "end_header\n"]).encode()
    return head + np.tile(bounds, chunks).tobytes() + words.tobytes() + harmonics.tobytes()


def inflated_spz(version: int, count: int, sh_degree: int) -> bytes:
    """Header and arrays of an SPZ of version 1, 2 or 3, not compressed."""
    row = (6 if version == 1 else 9) + 1 + 3 + 3 + (4 if version == 3 else 3)
    row += 3 * (sh_count(sh_degree) - 1)
    body = np.random.default_rng(version).integers(0, 256, count * row).astype(np.uint8).tobytes()
    head = HEADER_V4.pack(MAGIC, version, count, sh_degree, 12, 0, 0, 0, bytes(12))
    return head[:16] + body


def inflated_spz_4(count: int, sh_degree: int) -> bytes:
    """Header, table and arrays of an SPZ of version 4 without extensions, the arrays not
    compressed."""
    data = encode_spz(made_splats(count, sh_degree), SpzVersion.V4)
    head = data[:14] + bytes([0, data[15]]) + struct.pack("<I12x", HEADER_V4.size)
    data = head + data[int.from_bytes(data[16:20], "little") :]
    num_arrays, start = data[15], HEADER_V4.size + ENTRY.size * data[15]
    table, arrays = data[HEADER_V4.size : start], b""
    for size, _ in ENTRY.iter_unpack(table):
        arrays += zstandard.ZstdDecompressor().decompress(data[start : start + size])
        start += size
    assert num_arrays * ENTRY.size == len(table)
    return data[: HEADER_V4.size] + table + arrays


def records() -> bytes:
    packet = compress(bytes(range(99)))
    sent: list[Record] = [
        StartRecord(0, 8, made_manifest().to_json()),
        KeyframeRecord(0, 0, (packet,)),
        SliceRecord(1, (packet, b""), packet),
        SliceRecord(2, (packet,), None, 1),
        ErrorRecord("the disk is gone"),
        EndRecord(8),
    ]
    return b"".join(map(encode_record, sent))


def packed(num_segments: int, poster: str | None = None) -> bytes:
    """A packed stream with empty bytes for objects; nothing here reads them."""
    manifest = replace(made_manifest(), live=False, poster=poster)
    layers = manifest.num_layers
    count = manifest.segment_frames
    records = [
        SegmentRecord(
            n,
            n * count,
            count,
            tuple(range(3, 3 + layers)),
            (bytes(32),) * layers,
            (math.nan,) * layers,
            tuple(range(1, 2 + layers)),
            (bytes(32),) * (layers + 1),
        )
        for n in range(num_segments)
    ]
    index, manifest_json = b"".join(map(pack_record, records)), manifest.to_json()
    head = PackedHead(len(manifest_json), len(index), 5 if poster else 0, 0)
    layout = PackedLayout(head, manifest, records)
    made = bytearray(layout.size_bytes)
    for at, piece in layout.structure(lambda path: 0):
        made[at : at + len(piece)] = piece
    for path, data in (("manifest.json", manifest_json), ("index.bin", index)):
        at, size_bytes = layout.find(path) or (0, 0)
        made[at : at + size_bytes] = data
    return bytes(made)


def seeds() -> Iterator[tuple[str, str, bytes]]:
    """(target, name, input) of every file; each gives a value."""
    yield "manifest", "plain", made_manifest().to_json()
    yield "record", "all", records()
    yield "sealed_record", "slice", encode_record(SliceRecord(7, (b"ab", b"c"), None, 1))[4:]
    yield "sealed_record", "masked", encode_record(SliceRecord(7, (b"ab",), b"skip_map"))[4:]
    yield "sealed_record", "skip-map-only", encode_record(SliceRecord(7, (), b"skip_map"))[4:]
    yield "sealed_record", "keyframe", encode_record(KeyframeRecord(8, 1, (b"ab", b"c")))[4:]
    yield "sealed_record", "end", encode_record(EndRecord(3))[4:]
    yield "sealed_record", "start", encode_record(StartRecord(2, 5, b"{}"))[4:]
    yield "sealed_record", "error", encode_record(ErrorRecord("no"))[4:]
    for degree in (0, 2):
        yield "import", f"ply-{degree}", encode_ply(made_splats(4, degree))
        yield "import", f"spz-{degree}", encode_spz(made_splats(4, degree))
        yield "inflated_spz_4", str(degree), inflated_spz_4(3, degree)
    yield "import", "compressed", compressed_ply(5, 0)
    yield "import", "compressed-sh", compressed_ply(3, 9)
    for version in (1, 2, 3):
        content = inflated_spz(version, 3, version // 3)
        yield "import", f"spz-v{version}", gzip.compress(content, mtime=0)
        yield "inflated_spz", str(version), content
    yield "inflated_spz", "axes", gzip.decompress(encode_spz(made_splats(2, 1)))
    yield "splat", "six", encode_splat(made_splats(6, 0))
    yield "packed", "two", packed(2)
    yield "packed", "poster", packed(11, "art/köder.png")
    yield from slot_seeds()
    yield from foreign_seeds(made_splats(5, 0), made_splats(3, 1))


def found() -> Iterator[tuple[str, str, bytes]]:
    """(target, name, input) of inputs that once violated the property; each is refused today."""
    manifest = made_manifest().to_json()
    halved = manifest.replace(b'"title": ""', b'"title": "\\ud800"')
    yield "manifest", "half-a-surrogate-pair", halved
    yield "manifest", "text-for-a-number", manifest.replace(b'"width_px": 64', b'"width_px": "64"')
    yield "manifest", "list-for-a-name", manifest.replace(b'"name": "front"', b'"name": ["front"]')
    yield "import", "signalling-nan", signalling_glb(made_splats(2, 0))
    half = inflated_spz(1, 3, 0)
    yield "inflated_spz", "signalling-half", half[:16] + b"\xff\xfd" + half[18:]
    yield "sealed_record", "bytes-for-a-kind", b"\x81\xa4kind\xc4\x02no"


def main() -> None:
    CORPUS.mkdir(exist_ok=True)
    numbers = {name: number for number, name in enumerate(TARGETS)}
    for target, what, food in seeds():
        (CORPUS / f"{target}-{what}").write_bytes(bytes([numbers[target]]) + food)
    for target, what, food in found():
        (CORPUS / f"found-{target}-{what}").write_bytes(bytes([numbers[target]]) + food)


if __name__ == "__main__":
    main()
