"""Segments of a stream as segments of another one, chunk by chunk as they are.

A chunk and an object's table say the frame that they belong to. Where a segment keeps its place all
of it is copied; where it moves, these frame numbers alone are others: the first block of a packet,
which holds them, is coded again, and the blocks behind it are copied.
"""

from __future__ import annotations

from codec.coders.coder import EncodedChunk
from codec.coders.zstd import with_start
from codec.slots.slotchange import encoded_elsewhere
from codec.slots.slotchunk import Kind, with_birth
from codec.stream.integrity import CheckedObject
from codec.stream.manifest import MASKS, is_snapshot
from codec.stream.object import encode_packet
from codec.stream.reader import StreamReader

from .segmentfiles import Scores, SegmentFiles


def copy_segment(
    reader: StreamReader, segment: int, births: range, offset: int, files: SegmentFiles
) -> bool:
    """Writes the slices of `births`, some of those of `segment`, as the next segment of `files`;
    gives whether it is the same byte for byte.

    offset: added to births; a whole number of segments. What comes from the slice that becomes
    frame 0 is in the snapshots.
    """
    record, manifest = reader.records[segment], reader.manifest
    whole = len(births) == record.num_frames
    objects = {part: reader.read_object(segment, part) for part in manifest.parts}
    psnr_db: Scores | None = record.psnr_db if whole else None
    if whole and not offset:
        files.add({part: found.data for part, found in objects.items()}, len(births), psnr_db)
        return True
    for part, found in objects.items():
        for entry in found.entries:
            birth = entry.birth + offset
            if entry.birth in births and (birth or is_snapshot(part)):
                files.put(part, birth, renumbered(found, entry.birth, offset))
    files.end_segment(len(births), psnr_db)
    return False


def renumbered(found: CheckedObject, birth: int, offset: int) -> bytes:
    """The packet of `birth` in `found` as that of `birth` + `offset`."""
    packet = found.packet(birth)
    if not offset:
        return packet
    chunk = _chunk_elsewhere(found, birth, offset)
    copied = with_start(packet, chunk.data)
    return encode_packet(chunk) if copied is None else copied


def _chunk_elsewhere(found: CheckedObject, birth: int, offset: int) -> EncodedChunk:
    """The chunk of `birth` in `found`, to be compressed once more as that of `birth` + `offset`."""
    layout, part, data = found.manifest.slot_layout, found.part, found.content(birth)
    kind = Kind.CHANGE if isinstance(part, int) else Kind.SNAPSHOT
    if part == MASKS:
        kind = Kind.MASK
    return encoded_elsewhere(layout, kind, with_birth(data, birth + offset))
