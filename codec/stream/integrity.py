"""How the parts of a stream must agree: manifest, index, objects, chunks and slices.

Rule: every reader of a stream, wherever it comes from, checks it with these functions and with
nothing else. They take bytes and give values or a CodecError, whose place is one in those bytes, as
exactly as the format allows.
"""

from __future__ import annotations

import hashlib
from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass

from codec.errors import CodecError, CorruptError

from .manifest import Manifest, Part, is_keyframe
from .segment import (
    MAX_OBJECT_BYTES,
    NUM_CHUNKS_OFFSET,
    ChunkEntry,
    SegmentRecord,
    entry_offset,
    entry_packet,
    error_in_object,
    object_end,
    packet_content,
    parse_index,
    read_object_table,
    record_bytes,
    side_offset,
    size_offset,
)

MAX_INDEX_BYTES = 1 << 28
"""Longest index read at once; 100 hours of four layers in segments of a second take 71 MB."""


def read_index(
    data: bytes, manifest: Manifest, before: Sequence[SegmentRecord] = ()
) -> list[SegmentRecord]:
    """The records in `data`, which follows the records `before` in index.bin.

    A torn last record is left out, see `parse_index`.
    """
    num_layers = manifest.num_layers
    records = parse_index(data, num_layers, len(before))
    length = manifest.segment_frames
    previous = before[-1] if before else None
    for n, record in enumerate(records):
        at = n * record_bytes(num_layers)
        if previous is not None and previous.num_frames != length:
            raise CorruptError("index: a segment follows a short one", at)
        if record.first_frame != record.segment * length or record.num_frames > length:
            at += 8 if record.num_frames > length else 4
            raise CorruptError(f"index: segment {record.segment} does not fit the manifest", at)
        for number, size in enumerate(record.part_bytes):
            if size > MAX_OBJECT_BYTES:
                side = side_offset(number - num_layers, num_layers)
                raise CorruptError(
                    f"index: segment {record.segment} names too large an object",
                    at + (size_offset(number) if number < num_layers else side),
                )
        previous = record
    return records


def check_index_end(index_bytes: int, manifest: Manifest, num_records: int) -> None:
    """Raises CorruptError unless the index of a finished stream ends with its last whole record.

    A reader leaves out what follows: a writer may have been cut off there, or may still be at it,
    but only as long as the stream is live.
    """
    whole_bytes = num_records * record_bytes(manifest.num_layers)
    if not manifest.live and index_bytes != whole_bytes:
        raise CorruptError(
            f"index: {index_bytes - whole_bytes} bytes after the last whole record "
            "of a finished stream",
            whole_bytes,
        )


def check_object_bytes(data: bytes, record: SegmentRecord, number: int) -> None:
    """Raises CorruptError unless the object `data` has the size and the hash that `record` says.

    number: of a layer, or of another part of the segment (`Manifest.part_number`).
    """
    size = record.part_bytes[number]
    if len(data) != size:
        message = f"object: {len(data)} bytes, the index says {size}"
        raise CorruptError(message, min(len(data), size))
    if hashlib.sha256(data).digest() != record.part_sha256[number]:
        raise CorruptError("object: was altered: its hash differs from the index")


def object_table(
    data: bytes, manifest: Manifest, record: SegmentRecord, part: Part
) -> tuple[ChunkEntry, ...]:
    """The table of the object `data`, of which the packets may be cut short.

    Its births are of the segment; what changes nothing has none. It ends where `record` says that
    the object ends.
    """
    entries = read_object_table(data)
    births = manifest.part_births(record.segment, record.num_frames, part)
    if is_keyframe(part):
        _check_all_births(entries, births)
    else:
        _check_some_births(entries, births)
    end = object_end(entries)
    size = record.part_bytes[manifest.part_number(part)]
    if end != size:
        at = entry_offset(len(entries)) - 4 if entries else NUM_CHUNKS_OFFSET  # the last size
        raise CorruptError(f"object: its table says {end} bytes, the index {size}", at)
    return tuple(entries)


def _check_all_births(entries: Sequence[ChunkEntry], births: range) -> None:
    message = f"object: its births are not {births[0]}..{births[-1]}"
    for n, (entry, birth) in enumerate(zip(entries, births, strict=False)):
        if entry.birth != birth:
            raise CorruptError(message, entry_offset(n))
    if len(entries) != len(births):
        raise CorruptError(message, NUM_CHUNKS_OFFSET)


def _check_some_births(entries: Sequence[ChunkEntry], births: range) -> None:
    for n, entry in enumerate(entries):
        if entry.birth not in births:
            message = f"object: birth {entry.birth} is not one of {births[0]}..{births[-1]}"
            raise CorruptError(message, entry_offset(n))


def entry_content(data: bytes, entry: ChunkEntry, limit_bytes: int) -> bytes:
    """The chunk in the packet of `entry` in the object `data`, at most `limit_bytes`. The place of
    a CodecError is one in the object."""
    packet = entry_packet(data, entry)
    try:
        return packet_content(packet, limit_bytes)
    except CodecError as error:
        raise error_in_object(error, entry) from error


@dataclass(frozen=True, slots=True)
class CheckedObject:
    """An object that is as the index says, still compressed; its table is read and checked."""

    name: str
    """Where the bytes came from: what errors name."""
    data: bytes
    entries: tuple[ChunkEntry, ...]
    manifest: Manifest
    part: Part
    births: range
    """Births of the segment's slices; one that changes nothing here has no entry."""

    @staticmethod
    def check(
        name: str, data: bytes, manifest: Manifest, record: SegmentRecord, part: Part
    ) -> CheckedObject:
        """The object `data` of a segment, found at `name`. Raises a CodecError that names it."""
        try:
            check_object_bytes(data, record, manifest.part_number(part))
            entries = object_table(data, manifest, record, part)
        except CodecError as error:
            raise error.within(name) from error
        births = manifest.part_births(record.segment, record.num_frames, part)
        return CheckedObject(name, data, entries, manifest, part, births)

    def entry(self, birth: int) -> ChunkEntry | None:
        """Where the packet of the slice born at `birth`, one of this segment, lies; None if the
        slice changes nothing here."""
        at = bisect_left(self.entries, birth, key=lambda entry: entry.birth)
        if at < len(self.entries) and self.entries[at].birth == birth:
            return self.entries[at]
        assert birth in self.births, birth
        return None

    def packet(self, birth: int) -> bytes:
        """The packet of the slice born at `birth`, as it is; no bytes if it changes nothing."""
        entry = self.entry(birth)
        return self.data[entry.offset : entry.offset + entry.size] if entry else b""

    def content(self, birth: int) -> bytes:
        """The chunk of `birth` as bytes: a skip map, a change or a keyframe, or none.
        Raises a CodecError that names the object."""
        entry = self.entry(birth)
        if entry is None:
            return b""
        try:
            return entry_content(self.data, entry, self.manifest.max_content_bytes(self.part))
        except CodecError as error:
            raise error.within(self.name) from error

    def blamed(self, error: CodecError, birth: int) -> CodecError:
        """`error`, whose place is one in the chunk of `birth`, as one that names the object."""
        entry = self.entry(birth)
        if entry is None:
            return error.reworded(f"{self.name}: {error} (birth {birth})", None)
        return error_in_object(error, entry).within(self.name)
