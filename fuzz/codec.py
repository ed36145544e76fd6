"""Fuzzing of all parsers of untrusted bytes, with atheris (libFuzzer for Python).

The property under test: any bytes give a value or a CodecError; there is no other exception and no
numpy warning, and a value survives writing and reading. The first byte of an input chooses the
parser (`TARGETS`), the rest is the parser's input.

How to run it, from the root of the repository, in an environment of its own:

    python3 -m venv /tmp/fuzz
    /tmp/fuzz/bin/pip install atheris numba numpy zstandard msgpack pillow
    mkdir -p /tmp/found
    /tmp/fuzz/bin/python -m fuzz /tmp/found fuzz/corpus -max_total_time=600 -max_len=8192

The kernels (codec/kernel.py) run as Python, too, because numba cannot compile instrumented code. So
the fuzzer sees their branches, and an index out of bounds is an IndexError.

New inputs are written to the first folder, inputs that violate the property to ./crash-*.
`python -m fuzz FILE...` runs single files again; `tests/codec/test_fuzz.py` does so with the whole
corpus, without atheris. Inputs that found a bug, since fixed, are kept in fuzz/corpus as `found-*`;
`python -m fuzz.seed` rewrites the corpus. A new parser needs a function and an entry at the end of
TARGETS here, and a seed there. Skip maps, changes and keyframes are in fuzz/slots.py and
fuzz/slotseed.py, containers of other programs in fuzz/foreign.py and fuzz/foreignseed.py.
"""

from __future__ import annotations

import gzip
import struct
import zlib
from collections.abc import Callable
from contextlib import suppress

import zstandard

from codec.errors import CodecError
from codec.foreign.spz import ENTRY, HEADER_V4, decode_spz
from codec.interop.formats import decode_any
from codec.slots.changepacket import FORM, change_content, sealed
from codec.slots.slotlayout import MAX_LAYERS
from codec.stream.manifest import Manifest
from codec.stream.packedlayout import read_layout
from codec.stream.playrecord import RecordParser, encode_record
from codec.stream.segment import (
    CHECKSUM,
    entry_packet,
    pack_record,
    packet_content,
    parse_index,
    read_object_table,
    record_bytes,
)

from .foreign import (
    fuzz_bundle,
    fuzz_inflated_glb,
    fuzz_inflated_sog,
    fuzz_ksplat,
    fuzz_sequence,
    fuzz_webp,
)
from .slots import fuzz_change, fuzz_keyframe, fuzz_skip_map, fuzz_slots

MAX_PACKET_BYTES = 1 << 20
"""Maximum content of a packet that is inflated."""


def fuzz_packet(data: bytes) -> None:
    """One packet."""
    packet_content(data, MAX_PACKET_BYTES)


def fuzz_coded_change(data: bytes) -> None:
    """A packet of coded planes behind its first byte, with a correct checksum."""
    change_content(sealed(bytes([FORM]) + data), MAX_PACKET_BYTES)


def fuzz_object(data: bytes) -> None:
    """An object: its table and its packets."""
    entries = read_object_table(data)
    for entry in entries:
        packet_content(entry_packet(data, entry), MAX_PACKET_BYTES)


def fuzz_index(data: bytes) -> None:
    """Records of the index; the first byte gives the number of layers."""
    layers, data = data[0] % MAX_LAYERS + 1, data[1:]
    records = parse_index(data, layers)
    packed = b"".join(map(pack_record, records))
    assert len(packed) == len(records) * record_bytes(layers) <= len(data)
    # Compared as bytes, because a NaN does not equal itself.
    assert b"".join(map(pack_record, parse_index(packed, layers))) == packed


def fuzz_sealed_index(data: bytes) -> None:
    """Records of the index with correct checksums, so that the code behind the check is reached."""
    size = record_bytes(data[0] % MAX_LAYERS + 1)
    sealed = data[:1]
    for start in range(1, len(data) - size + 1, size):
        body = data[start : start + size - CHECKSUM.size]
        sealed += body + CHECKSUM.pack(zlib.crc32(body))
    fuzz_index(sealed)


def fuzz_manifest(data: bytes) -> None:
    """manifest.json."""
    manifest = Manifest.from_json(data)
    assert Manifest.from_json(manifest.to_json()).to_json() == manifest.to_json()
    assert manifest.object_path(3, 1)
    assert manifest.camera().name == manifest.default_camera
    assert manifest.births(0, 1) == range(1)
    assert all(manifest.max_content_bytes(part) > 0 for part in manifest.parts)


def fuzz_record(data: bytes) -> None:
    """The body of a /play response, in two pieces."""
    parser = RecordParser()
    half = len(data) // 2
    for record in [*parser.feed(data[:half]), *parser.feed(data[half:])]:
        assert RecordParser().feed(encode_record(record)) == [record]


def fuzz_sealed_record(data: bytes) -> None:
    """One play record with a correct length."""
    fuzz_record(struct.pack("<I", len(data)) + data)


def fuzz_import(data: bytes) -> None:
    """A file of Gaussians in the format of its first bytes: PLY, compressed PLY, SPZ, SOG, glTF."""
    decode_any(data)


def fuzz_splat(data: bytes) -> None:
    """A .splat file, which has no magic."""
    decode_any(data, ".splat")


def fuzz_inflated_spz(data: bytes) -> None:
    """The content of an SPZ of version 1, 2 or 3; the target compresses it."""
    decode_spz(gzip.compress(data, compresslevel=1, mtime=0))


def fuzz_inflated_spz_4(data: bytes) -> None:
    """Header and arrays of an SPZ of version 4; the target splits and compresses the arrays."""
    head, rest = data[: HEADER_V4.size], data[HEADER_V4.size :]
    if len(head) < HEADER_V4.size:
        decode_spz(head)
        return
    table_bytes = ENTRY.size * head[15]
    compressor = zstandard.ZstdCompressor(level=1)
    table, frames, start = b"", b"", table_bytes
    whole_bytes = min(table_bytes, len(rest) // ENTRY.size * ENTRY.size)
    for _, raw_bytes in ENTRY.iter_unpack(rest[:whole_bytes]):
        frame = compressor.compress(rest[start : start + raw_bytes])
        start = min(start + raw_bytes, len(rest))
        table += ENTRY.pack(len(frame), raw_bytes)
        frames += frame
    decode_spz(head + table + frames)


def fuzz_packed(data: bytes) -> None:
    """A packed stream: for any declared sizes, all its files are inside it, one after another."""

    def read(offset: int, most_bytes: int) -> tuple[bytes, int]:
        return data[offset : offset + most_bytes], len(data)

    layout = read_layout(read)
    end = 0
    for path, at, size_bytes in layout.files():
        assert layout.find(path) == (at, size_bytes)
        assert end < at <= at + size_bytes <= len(data)
        end = at + size_bytes
    places = list(layout.structure(lambda path: 0))
    assert places[0][0] == 0
    assert places[-1][0] + len(places[-1][1]) == layout.size_bytes == len(data)


TARGETS: dict[str, Callable[[bytes], None]] = {
    "packet": fuzz_packet,
    "object": fuzz_object,
    "index": fuzz_index,
    "sealed_index": fuzz_sealed_index,
    "manifest": fuzz_manifest,
    "record": fuzz_record,
    "sealed_record": fuzz_sealed_record,
    "import": fuzz_import,
    "splat": fuzz_splat,
    "inflated_spz": fuzz_inflated_spz,
    "inflated_spz_4": fuzz_inflated_spz_4,
    "skip_map": fuzz_skip_map,
    "change": fuzz_change,
    "keyframe": fuzz_keyframe,
    "slots": fuzz_slots,
    "bundle": fuzz_bundle,
    "webp": fuzz_webp,
    "inflated_sog": fuzz_inflated_sog,
    "inflated_glb": fuzz_inflated_glb,
    "packed": fuzz_packed,
    "ksplat": fuzz_ksplat,
    "sequence": fuzz_sequence,
    "coded_change": fuzz_coded_change,
}
"""The parsers by name. Only append: the first byte of an input is an index in this order."""

_BY_NUMBER = tuple(TARGETS.values())


def accepts(data: bytes) -> bool:
    """Whether the parser that `data` chooses gave a value. Raises what no parser may raise."""
    if len(data) < 2:
        return False
    with suppress(CodecError):
        _BY_NUMBER[data[0] % len(_BY_NUMBER)](data[1:])
        return True
    return False
