"""Whether the objects of a stream hold together, byte for byte."""

from __future__ import annotations

import numpy as np

from codec.errors import CodecError, CorruptError
from codec.slice import window_births
from codec.slots.slotdecoder import SlotDecoder
from codec.slots.slotstate import ESCAPED, ON_LATTICE, Slots, holds
from codec.slots.snapshot import Snapshot, decode_snapshot
from codec.stream.index import SegmentRecord
from codec.stream.integrity import (
    CheckedObject,
    check_object_bytes,
    entry_content,
    object_table,
)
from codec.stream.manifest import MASKS, Part, object_name, snapshot_part
from codec.stream.object import MAX_OBJECT_BYTES
from codec.stream.reader import StreamReader, read_stream_file
from codec.stream.seeker import join, roll


def verify_objects(reader: StreamReader) -> None:
    """Reads, checks and decodes every object; a snapshot must be what the slices before it have
    led to. Raises a CodecError that names the file and the first byte that may be wrong."""
    manifest = reader.manifest
    decoder = SlotDecoder(manifest.slot_layout)
    for record in reader.records:
        segment = {part: _whole_object(reader, record, part) for part in manifest.parts}

        def find(
            number: int, part: Part, objects: dict[Part, CheckedObject] = segment
        ) -> CheckedObject:
            return objects[part]

        first = record.first_frame
        if first == 0:
            join(find, manifest, 0, decoder)
            _check_first_slice(decoder, segment)
        else:
            roll(find, manifest, first, decoder)
            for layer in range(manifest.num_layers):
                _check_snapshot(decoder, segment[snapshot_part(layer)], first, layer)
        roll(find, manifest, first + record.num_frames - 1, decoder)


def _whole_object(reader: StreamReader, record: SegmentRecord, part: Part) -> CheckedObject:
    """The object of `part`, whose packets all inflate."""
    manifest = reader.manifest
    place = reader.object_place(record.segment, part)
    data = read_stream_file(reader.storage, object_name(record.segment, part), MAX_OBJECT_BYTES)
    damage: CodecError | None = None
    try:
        check_object_bytes(data, record, manifest.part_number(part))
    except CodecError as error:
        damage = error
    try:
        entries = object_table(data, manifest, record, part)
        for entry in entries:
            entry_content(data, entry, manifest.max_content_bytes(part))
    except CodecError as error:
        # The table or a packet shows the place of the damage; a hash does not.
        altered = error if damage is None else error.reworded(f"was altered: {error}", error.at)
        raise altered.within(place) from error
    if damage is not None:
        raise damage.within(place)
    births = manifest.part_births(record.segment, record.num_frames, part)
    return CheckedObject(place, data, entries, manifest, part, births)


def _check_first_slice(decoder: SlotDecoder, segment: dict[Part, CheckedObject]) -> None:
    """The slice born at 0 is in the snapshots: its own packets, if any, keep all slots."""
    masks = segment[MASKS]
    layers = [segment[layer] for layer in range(decoder.num_layers)]

    def blamed(error: CodecError, layer: int | None) -> CodecError:
        return (masks if layer is None else layers[layer]).blamed(error, 0)

    statuses = decoder.statuses(0, masks.content(0), [one.content(0) for one in layers], blamed)
    if statuses.any():
        error = CorruptError("mask: the slice born at 0 does not keep all slots")
        raise masks.blamed(error, 0)


def _check_snapshot(decoder: SlotDecoder, found: CheckedObject, frame: int, layer: int) -> None:
    """Raises CorruptError unless the snapshot is what `decoder` holds at `frame`."""
    content = found.content(frame)
    try:
        snapshot = decode_snapshot(decoder.layout, content)
        _check_header(snapshot, frame, layer)
        births = window_births(frame, decoder.layout.swin_size)
        for birth, slots in zip(births, snapshot.lanes, strict=True):
            held = decoder.lanes[decoder.layout.lane(birth)][layer]
            if not _same(held, slots, frame - birth):
                raise CorruptError(
                    f"snapshot: the lane of birth {birth} is not what the slices before it left"
                )
    except CodecError as error:
        raise found.blamed(error, frame) from error


def _check_header(snapshot: Snapshot, frame: int, layer: int) -> None:
    if (snapshot.frame, snapshot.layer) != (frame, layer):
        raise CorruptError(
            f"snapshot: of frame {snapshot.frame} layer {snapshot.layer} where frame {frame} layer "
            f"{layer} belongs"
        )


def _same(held: Slots, read: Slots, age: int) -> bool:
    """Whether both hold the same Gaussians, and those that have not started by now, `age` frames
    after the lane's birth, start at the same time."""
    here, inside = holds(held.conditions), held.conditions == ON_LATTICE
    order = np.argsort(held.escape_rows, kind="stable")
    pairs = zip(held.escapes.take(order).arrays, read.escapes.arrays, strict=True)
    return (
        (held.conditions == read.conditions).all()
        and (held.states.positions[inside] == read.states.positions[inside]).all()
        and (held.states.attributes[inside] == read.states.attributes[inside]).all()
        and (np.maximum(held.starts, age)[here] == np.maximum(read.starts, age)[here]).all()
        and np.array_equal(held.escape_rows[order], np.flatnonzero(read.conditions == ESCAPED))
        and all(a.tobytes() == b.tobytes() for a, b in pairs)
    )
