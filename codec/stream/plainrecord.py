"""Play records for readers that cannot inflate zstd by themselves, as browsers (FORMAT.md, 10).

Rule: a packet of coder zstd is in them as its content, and the whole body is coded by HTTP. As any
zstd frames behind one another are one body, with `Content-Encoding: zstd` the packet goes out as it
is stored, and nothing is compressed twice. A packet of coder gzip, which they can inflate, is in
them as it is.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Sequence

import msgpack
import zstandard

from codec.coders import zstd
from codec.coders.coder import Coder, coder_of
from codec.errors import InvalidError

from .object import ChunkEntry
from .playrecord import (
    LENGTH,
    MAX_RECORD_BYTES,
    PACKETS_KEY,
    Record,
    SliceRecord,
    SnapshotRecord,
    encode_record,
)

MAX_WINDOW_BYTES = 8 << 20
"""Browsers refuse zstd frames that need more (RFC 9659)."""

ZSTD, GZIP = CODINGS = ("zstd", "gzip")
"""Codings of a body, the best first. Browsers take zstd from https and from their own machine;
gzip, which costs the server time, wherever they are."""

GZIP_LEVEL = 4
"""zlib level: what one client needs is compressed while it waits."""

GZIP_WBITS = 16 + zlib.MAX_WBITS
"""zlib's way to say gzip."""

HEAD_LEVEL = 1
"""zstd level of what stands between packets."""

Piece = tuple[bytes, int | None]
"""A part of a record that is sent in one: its bytes, and the content size if it is a packet of
coder zstd, else None."""


class PlainRecordEncoder:
    """Encodes the records of one response, in order."""

    def __init__(self, coding: str) -> None:
        """coding: what the response says as Content-Encoding, one of CODINGS; nothing for none."""
        self.coding = coding
        self._zstd = zstandard.ZstdCompressor(HEAD_LEVEL) if coding == ZSTD else None
        self._gzip = zlib.compressobj(GZIP_LEVEL, wbits=GZIP_WBITS) if coding == GZIP else None

    @property
    def continues(self) -> bool:
        """Whether a record's bytes depend on the records before it."""
        return self._gzip is not None

    def encode(self, record: Record, last: bool = False) -> bytes:
        """The record's bytes in the body, all that a reader needs to take it; last: with the end of
        the body. Raises InvalidError if no reader would take them, and CorruptError for a packet
        that is not one."""
        return self.encode_sized(record, last)[0]

    def encode_sized(self, record: Record, last: bool = False) -> tuple[bytes, int]:
        """The same, and the record's bytes as its reader gets them, without the body's coding."""
        pieces = _pieces(record)
        plain_bytes = sum(len(data) if size is None else size for data, size in pieces)
        if self._zstd is not None:
            coded = (self._zstd.compress(data) if size is None else data for data, size in pieces)
            return b"".join(coded), plain_bytes
        body = b"".join(
            data if size is None else zstd.decompress(data, size) for data, size in pieces
        )
        if self._gzip is None:
            return body, plain_bytes
        flush = zlib.Z_FINISH if last else zlib.Z_SYNC_FLUSH
        return self._gzip.compress(body) + self._gzip.flush(flush), plain_bytes


def inflates_whole(data: bytes, entries: Sequence[ChunkEntry]) -> bool:
    """Whether the object `data` is one zstd stream that a browser takes as `Content-Encoding:
    zstd`. entries: its table."""
    for entry in entries:
        packet = memoryview(data)[entry.offset : entry.offset + entry.size]
        if not packet:
            continue  # a chunk of nothing
        if coder_of(packet) is not Coder.ZSTD:
            return False
        if zstandard.get_frame_parameters(packet).window_size > MAX_WINDOW_BYTES:
            return False
    return True


def _pieces(record: Record) -> list[Piece]:
    match record:
        case SliceRecord():
            value: dict[str, object] = {"kind": "slice", "birth": record.birth}
            if record.first_layer:
                value["first"] = record.first_layer
            mask = record.mask
        case SnapshotRecord():
            value = {"kind": "snapshot", "frame": record.frame, "first": record.first_layer}
            mask = None
        case _:
            return [(encode_record(record), None)]
    packer = msgpack.Packer()
    head = bytearray(packer.pack_map_header(len(value) + 1 + (mask is not None)))
    for key, number in value.items():
        head += packer.pack(key) + packer.pack(number)
    pieces: list[Piece] = []
    if mask is not None:
        head += packer.pack("mask")
        head = _add_packet(pieces, head, mask)
    head += packer.pack(PACKETS_KEY) + packer.pack_array_header(len(record.packets))
    for packet in record.packets:
        head = _add_packet(pieces, head, packet)
    if head:
        pieces.append((bytes(head), None))
    length = sum(len(data) if size is None else size for data, size in pieces)
    if length > MAX_RECORD_BYTES:
        raise InvalidError(f"play: a record of {length} bytes, at most {MAX_RECORD_BYTES}")
    return [(LENGTH.pack(length) + pieces[0][0], None), *pieces[1:]]


def _add_packet(pieces: list[Piece], head: bytearray, packet: bytes) -> bytearray:
    """Adds `packet` behind `head`; gives the head of what follows."""
    if not packet or coder_of(packet) is Coder.GZIP:
        return head + _bin_header(len(packet)) + packet
    size = zstd.content_bytes(packet, MAX_WINDOW_BYTES)
    window_bytes = zstandard.get_frame_parameters(packet).window_size
    if window_bytes > MAX_WINDOW_BYTES:
        raise InvalidError(
            f"packet: a browser accepts no zstd frame that needs {window_bytes} bytes"
        )
    head += _bin_header(size)
    pieces += [(bytes(head), None), (packet, size)]
    return bytearray()


def _bin_header(size: int) -> bytes:
    """The msgpack header of a bin value of `size` bytes."""
    if size < 1 << 8:
        return struct.pack(">BB", 0xC4, size)
    if size < 1 << 16:
        return struct.pack(">BH", 0xC5, size)
    return struct.pack(">BI", 0xC6, size)
