"""Reads the folder of a stream, written from codec/FORMAT.md alone: slow and plain."""

from __future__ import annotations

import hashlib
import json
import math
import struct
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.goldens.decoder import Lattice, Shape, Slot, Unsupported, f32
from tests.goldens.objects import LARGEST_CHUNK, LARGEST_OBJECT, decode_object
from tests.goldens.reader import Reader

Lanes = list[list[list[Slot]]]


@dataclass(frozen=True, slots=True)
class IndexEntry:
    size: int
    sha256: bytes


@dataclass(frozen=True, slots=True)
class IndexRecord:
    first_frame: int
    num_frames: int
    files: dict[str, IndexEntry]  # by the name of the object


# --- Section 4: manifest ---


def value_of(values: Any, key: str) -> Any:
    assert isinstance(values, dict)
    assert key in values
    return values[key]


def integer(value: object, least: int, most: int) -> int:
    assert isinstance(value, int)
    assert not isinstance(value, bool)
    assert least <= value <= most
    return value


def number(value: object, least: float, most: float) -> float:
    """`value` as f32, between `least` and `most`."""
    assert isinstance(value, int | float)
    assert not isinstance(value, bool)
    assert least <= value <= most
    return f32(value)


def step(value: object) -> float:
    return number(value, 1e-6, 1e6)


def read_manifest(text: bytes) -> Shape:
    """The data of the manifest that decoding needs."""
    assert len(text) <= 2**20
    manifest: Any = json.loads(text)
    version = value_of(manifest, "version")
    assert isinstance(version, int)
    if version != 1:
        raise Unsupported
    swin_size = integer(value_of(manifest, "swin_size"), 1, 255)
    num_gs = integer(value_of(manifest, "num_gs"), 1, 2**24)
    segment_frames = integer(value_of(manifest, "segment_frames"), 1, 4096)
    sh_degree = integer(value_of(manifest, "sh_degree"), 0, 3)
    counts, lattices = value_of(manifest, "slots"), value_of(manifest, "lattice")
    assert isinstance(counts, list)
    assert isinstance(lattices, list)
    assert 1 <= len(counts) <= 16
    assert len(lattices) == len(counts)
    slots = tuple(integer(count, 1, 2**20) for count in counts)
    assert sum(slots) <= 2**20
    assert sum(slots) * swin_size == num_gs
    assert segment_frames * sum(slots) <= 2**28
    lattice = tuple(
        Lattice(
            step(value_of(row, "position_m")),
            step(value_of(row, "log_scale")),
            number(value_of(row, "log_scale_base"), -1e3, 1e3),
            step(value_of(row, "rotation")),
            step(value_of(row, "colour")),
            integer(value_of(row, "opacity_levels"), 2, 256),
        )
        for row in lattices
    )
    return Shape(swin_size, segment_frames, (sh_degree + 1) ** 2, slots, lattice)


# --- Sections 3, 5 and 6: index and files ---


def file_names(num_layers: int) -> list[str]:
    """The objects of a segment, in the order of their entries in the index."""
    layers = range(num_layers)
    return [*map(str, layers), "skipmaps", *(f"keyframe-{layer}" for layer in layers)]


def read_index(data: bytes, shape: Shape) -> list[IndexRecord]:
    num_layers = len(shape.slots)
    size = 20 + 44 * num_layers + 40 * (num_layers + 1)
    rows = [data[i : i + size] for i in range(0, len(data) - size + 1, size)]
    if rows and not any(rows[-1]):
        rows.pop()
    records = [read_record(row, n, shape) for n, row in enumerate(rows)]
    assert all(record.num_frames == shape.segment_frames for record in records[:-1])
    return records


def read_record(row: bytes, n: int, shape: Shape) -> IndexRecord:
    num_layers = len(shape.slots)
    assert zlib.crc32(row[:-4]) == struct.unpack("<I", row[-4:])[0]
    segment, first_frame, num_frames, zero = struct.unpack_from("<4I", row)
    assert (segment, first_frame, zero) == (n, n * shape.segment_frames, 0)
    assert 1 <= num_frames <= shape.segment_frames
    places = [16 + 44 * layer for layer in range(num_layers)]
    psnr_db = tuple(struct.unpack_from("<f", row, at + 40)[0] for at in places)
    assert not any(map(math.isinf, psnr_db))
    places += [16 + 44 * num_layers + 40 * i for i in range(num_layers + 1)]
    entries = [IndexEntry(*struct.unpack_from("<Q32s", row, at)) for at in places]
    assert all(entry.size <= LARGEST_OBJECT for entry in entries)
    files = dict(zip(file_names(num_layers), entries, strict=True))
    return IndexRecord(first_frame, num_frames, files)


def largest_content(name: str, shape: Shape) -> int:
    """Maximum bytes that the slots can need in a chunk of this object."""
    if name == "skipmaps":
        return 16 + 4 * sum(shape.slots)
    num_slots = shape.slots[int(name.removeprefix("keyframe-"))]
    flag_bytes = 0
    if not name.isdecimal():
        num_slots *= shape.swin_size
        flag_bytes = (num_slots + 7) // 8
    filled = 32 + flag_bytes + (68 + 15 * shape.num_coefficients) * num_slots
    return min(filled, LARGEST_CHUNK)


def births_of(chunks: list[bytes]) -> list[int]:
    return [struct.unpack_from("<i", chunk, 8)[0] for chunk in chunks]


class StreamFolder:
    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.shape = read_manifest((folder / "manifest.json").read_bytes())
        self.index = read_index((folder / "index.bin").read_bytes(), self.shape)
        self.num_frames = sum(record.num_frames for record in self.index)

    def chunks(self, segment: int, name: str) -> dict[int, bytes]:
        """The chunks of an object by birth; empty for a birth without changes."""
        record = self.index[segment]
        data = (self.folder / "segments" / str(segment) / name).read_bytes()
        entry = record.files[name]
        assert (len(data), hashlib.sha256(data).digest()) == (entry.size, entry.sha256)
        chunks = decode_object(data, largest_content(name, self.shape))
        births = births_of(chunks)
        first = record.first_frame
        if name.startswith("keyframe-"):
            assert births == [first]
        else:
            assert set(births) <= set(range(first, first + record.num_frames))
            found = dict(zip(births, chunks, strict=True))
            return {b: found.get(b, b"") for b in range(first, first + record.num_frames)}
        return dict(zip(births, chunks, strict=True))

    def reader_at(self, frame: int, num_layers: int) -> Reader:
        """A reader that has joined at `frame` with layers 0..num_layers-1."""
        assert 0 <= frame < self.num_frames
        reader, segment = Reader(self.shape), frame // self.shape.segment_frames
        for layer in range(num_layers):
            (chunk,) = self.chunks(segment, f"keyframe-{layer}").values()
            assert chunk[5:6] == bytes([layer])
            reader.load(chunk)
        skip_maps = self.chunks(segment, "skipmaps")
        changes = [self.chunks(segment, str(layer)) for layer in range(num_layers)]
        for birth in range(self.index[segment].first_frame + 1, frame + 1):
            here = {layer: chunks[birth] for layer, chunks in enumerate(changes)}
            reader.apply(birth, skip_maps[birth], here)
        return reader


def state_at(folder: Path, frame: int, num_layers: int) -> Lanes:
    """The slots, [lane][layer][slot], of a reader that joins at `frame`."""
    return StreamFolder(folder).reader_at(frame, num_layers).lanes
