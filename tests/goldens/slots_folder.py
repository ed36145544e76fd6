"""Reads the folder of a stream of version 2, written from codec/FORMAT.md alone: slow and plain."""

from __future__ import annotations

import hashlib
import json
import math
import struct
import zlib
from collections.abc import Collection
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from tests.goldens.format_decoder import decode_object, f32
from tests.goldens.slots_decoder import Hole, Lattice, Shape, Slot, Unsupported
from tests.goldens.slots_reader import Reader

LARGEST_CHUNK = 64 + 248512560
LARGEST_OBJECT = 2**30

Lanes = list[list[list[Slot]]]


@dataclass(frozen=True, slots=True)
class IndexEntry:
    size: int
    sha256: bytes


@dataclass(frozen=True, slots=True)
class IndexRecord:
    first_frame: int
    num_frames: int
    psnr_db: tuple[float, ...]
    files: dict[str, IndexEntry]  # by the name of the object


# --- Section 19: manifest ---


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
    """As f32."""
    assert isinstance(value, int | float)
    assert not isinstance(value, bool)
    assert least <= value <= most
    return f32(value)


def step(value: object) -> float:
    return number(value, 1e-6, 1e6)


def read_manifest(text: bytes) -> Shape:
    """What decoding needs of the manifest; the rest of it is that of section 9."""
    assert len(text) <= 2**20
    manifest: Any = json.loads(text)
    if value_of(manifest, "version") != 2 or value_of(manifest, "profile") != "lattice":
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


# --- Section 18: objects and files ---


def file_names(num_layers: int) -> list[str]:
    """The objects of a segment, in the order of their entries in the index."""
    layers = range(num_layers)
    return [*map(str, layers), "masks", *(f"snapshot-{layer}" for layer in layers)]


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
    return IndexRecord(first_frame, num_frames, psnr_db, files)


def largest_content(name: str, shape: Shape) -> int:
    """The bytes that the slots can fill in a chunk of this object."""
    if name == "masks":
        return 16 + 4 * sum(shape.slots)
    num_slots = shape.slots[int(name.removeprefix("snapshot-"))]
    flag_bytes = 0
    if not name.isdecimal():
        num_slots *= shape.swin_size
        flag_bytes = (num_slots + 7) // 8
    filled = 32 + flag_bytes + (68 + 15 * shape.num_coefficients) * num_slots
    return min(filled, LARGEST_CHUNK)


def decoded_whole(name: str, chunks: list[bytes], shape: Shape) -> int:
    """What a reader that decodes an object whole counts; it refuses more than 2^30."""
    if name == "masks":
        return len(chunks) * sum(shape.slots)
    at = 12
    if not name.isdecimal():
        at += (shape.swin_size * shape.slots[int(name.removeprefix("snapshot-"))] + 7) // 8
    assert all(len(chunk) >= at + 8 for chunk in chunks)
    total = 0
    for chunk in chunks:
        predicted, new = struct.unpack_from("<II", chunk, at)
        total += int(predicted + new)
    return total * 4 * (11 + 3 * shape.num_coefficients)


def births_of(chunks: list[bytes]) -> list[int]:
    return [struct.unpack_from("<i", chunk, 8)[0] for chunk in chunks]


class StreamFolder:
    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.shape = read_manifest((folder / "manifest.json").read_bytes())
        self.index = read_index((folder / "index.bin").read_bytes(), self.shape)
        self.num_frames = sum(record.num_frames for record in self.index)

    def chunks(self, segment: int, name: str) -> dict[int, bytes]:
        """The chunks of an object by birth; no bytes for a birth at which nothing changes."""
        record = self.index[segment]
        data = (self.folder / "segments" / str(segment) / name).read_bytes()
        entry = record.files[name]
        assert (len(data), hashlib.sha256(data).digest()) == (entry.size, entry.sha256)
        chunks = decode_object(data, 2, largest_content(name, self.shape))
        assert decoded_whole(name, chunks, self.shape) <= 2**30
        births = births_of(chunks)
        first = record.first_frame
        if name.startswith("snapshot-"):
            assert births == [first]
        else:
            assert set(births) <= set(range(first, first + record.num_frames))
            found = dict(zip(births, chunks, strict=True))
            return {b: found.get(b, b"") for b in range(first, first + record.num_frames)}
        return dict(zip(births, chunks, strict=True))

    def load(self, reader: Reader, segment: int, layers: Collection[int]) -> None:
        """Loads the snapshots of a segment."""
        for layer in layers:
            (chunk,) = self.chunks(segment, f"snapshot-{layer}").values()
            assert chunk[5:6] == bytes([layer])
            reader.load(chunk)

    def apply(
        self,
        reader: Reader,
        births: range,
        layers: Collection[int],
        missing: Collection[tuple[int, int]] = (),
        missing_masks: Collection[int] = (),
    ) -> None:
        """Applies slices; `missing` names (birth, layer) of packets that are not at hand."""
        opened: dict[tuple[int, str], dict[int, bytes]] = {}
        for birth in births:
            segment = birth // self.shape.segment_frames
            for name in ("masks", *map(str, layers)):
                if (segment, name) not in opened:
                    opened[segment, name] = self.chunks(segment, name)
            changes = {
                layer: opened[segment, str(layer)][birth]
                for layer in layers
                if (birth, layer) not in missing
            }
            mask = None if birth in missing_masks else opened[segment, "masks"][birth]
            reader.apply(birth, mask, changes)


def state_at(folder: Path, frame: int, num_layers: int) -> Lanes:
    """The slots, [lane][layer][slot], for who joins at `frame`."""
    stream = StreamFolder(folder)
    assert 0 <= frame < stream.num_frames
    segment = frame // stream.shape.segment_frames
    first = stream.index[segment].first_frame
    reader = Reader(stream.shape)
    stream.load(reader, segment, range(num_layers))
    stream.apply(reader, range(first + 1, frame + 1), range(num_layers))
    return reader.lanes


def state_played(
    folder: Path, frame: int, num_layers: int, missing: Collection[tuple[int, int]] = ()
) -> Lanes:
    """The slots for who has played from frame 0 on, and never loaded another snapshot."""
    stream = StreamFolder(folder)
    assert 0 <= frame < stream.num_frames
    reader = Reader(stream.shape)
    stream.load(reader, 0, range(num_layers))
    stream.apply(reader, range(1, frame + 1), range(num_layers), missing)
    return reader.lanes


def without_passed_starts(lanes: Lanes, frame: int) -> Lanes:
    """As two readers may compare at `frame`: a start that has passed counts as `frame`."""

    def passed(slot: Slot) -> Slot:
        return slot if isinstance(slot, Hole) else replace(slot, start=max(slot.start, frame))

    return [[[passed(slot) for slot in layer] for layer in lane] for lane in lanes]
