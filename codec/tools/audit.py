"""Contents and integrity of a stream, `swings-stream info` and `verify`: its sizes, the statuses of
its slots, and whether its objects hold together, byte for byte.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from codec.arrays import Longs
from codec.errors import CodecError, CorruptError
from codec.slice import window_births
from codec.slots.decoder import SlotDecoder
from codec.slots.skipmap import SkipMapHistory, decode_skip_map
from codec.slots.slotlayout import NEW, PREDICTED
from codec.slots.state import ESCAPED, ON_LATTICE, Keyframe, Slots, decode_keyframe, holds
from codec.storage.openstorage import Place
from codec.stream.integrity import (
    CheckedObject,
    check_index_end,
    check_object_bytes,
    entry_content,
    object_table,
)
from codec.stream.manifest import SKIP_MAPS, Part, Point, keyframe_part, object_name
from codec.stream.packedstorage import PackedStorage
from codec.stream.pictures import check_pictures
from codec.stream.reader import DEFAULT_MAX_GAUSSIANS, StreamReader, join, read_stream_file, roll
from codec.stream.segment import INDEX_NAME, MAX_OBJECT_BYTES, SegmentRecord
from codec.stream.streampacker import verify_packed
from codec.tracks.streamtracks import verify_captions


@dataclass(frozen=True, slots=True)
class SlotCensus:
    """Counts of a stream of F frames and L layers."""

    statuses: Longs
    """(F, L, 4) how many slots the slice born at each frame says KEPT, ENDED, PREDICTED, NEW of."""
    first: Longs
    """(L,) Gaussians in the keyframes of frame 0."""

    @property
    def brought(self) -> Longs:
        """(L,) Gaussians sent to a player from frame 0 on: those of the first keyframes, and all
        that a slice changes or adds."""
        sent: Longs = self.statuses[:, :, [PREDICTED, NEW]].sum(axis=(0, 2))
        return self.first + sent


def count_slots(reader: StreamReader) -> SlotCensus:
    """The census of a stream, from its skip maps and its first keyframes. Raises a
    CodecError that names the object at fault."""
    layout = reader.manifest.slot_layout
    history = SkipMapHistory(layout)
    counts = np.zeros((reader.num_frames, layout.num_layers, 4), np.int64)
    for record in reader.records:
        skip_maps = reader.read_object(record.segment, SKIP_MAPS)
        for birth in range(record.first_frame, record.first_frame + record.num_frames):
            content = skip_maps.content(birth)
            try:
                statuses = decode_skip_map(layout, birth, content, history.of(birth))
            except CodecError as error:
                raise skip_maps.blamed(error, birth) from error
            history.note(birth, statuses)
            for layer, part in enumerate(np.split(statuses, layout.row_edges[1:-1])):
                counts[birth, layer] = np.bincount(part, minlength=4)
    return SlotCensus(counts, _first(reader))


def _first(reader: StreamReader) -> Longs:
    layout = reader.manifest.slot_layout
    held = np.zeros(layout.num_layers, np.int64)
    if reader.records:
        for layer in range(layout.num_layers):
            found = reader.read_object(0, keyframe_part(layer))
            content = found.content(0)
            try:
                keyframe = decode_keyframe(layout, content)
            except CodecError as error:
                raise found.blamed(error, 0) from error
            held[layer] = sum(int(holds(slots.conditions).sum()) for slots in keyframe.lanes)
    return held


@dataclass(frozen=True, slots=True)
class SlotSummary:
    """The census of slots for `swings-stream info`; the tuples have one entry for each layer.

    The means are of the slices born after frame 0, for that of frame 0 is in the keyframes.
    """

    slots: tuple[int, ...]
    """Slots of a lane."""
    kept: tuple[float, ...]
    """Slots of a slice, as a mean; the same of the next three."""
    predicted: tuple[float, ...]
    new: tuple[float, ...]
    ended: tuple[float, ...]
    skip_map_bytes: int
    change_bytes: tuple[int, ...]
    first_keyframe_bytes: tuple[int, ...]
    """Keyframes of frame 0, which a player from there on fetches."""
    join_keyframe_bytes: tuple[int, ...]
    """Keyframes of all later segments, which players fetch that join there."""


def summarise_slots(reader: StreamReader, census: SlotCensus) -> SlotSummary:
    records, num_layers = reader.records, reader.manifest.num_layers
    later = census.statuses[1:]
    means = later.sum(axis=0) / max(len(later), 1)
    changes = np.array([r.object_bytes for r in records], np.int64).reshape(-1, num_layers)
    sides = np.array([r.side_bytes for r in records], np.int64).reshape(-1, num_layers + 1)
    kept, ended, predicted, new = (tuple(of_status) for of_status in means.T.tolist())
    return SlotSummary(
        reader.manifest.slots,
        kept,
        predicted,
        new,
        ended,
        int(sides[:, 0].sum()),
        tuple(changes.sum(axis=0).tolist()),
        tuple(sides[:1, 1:].sum(axis=0).tolist()),
        tuple(sides[1:, 1:].sum(axis=0).tolist()),
    )


def describe_slots(summary: SlotSummary) -> list[str]:
    """Lines for people."""
    s = summary
    named = ("kept", s.kept), ("predicted", s.predicted), ("new", s.new), ("ended", s.ended)
    means = ", ".join(f"{sum(values):.1f} {name}" for name, values in named)
    lines = [f"slots        {sum(s.slots)} a slice; as a mean {means}"]
    lines.append(f"skip maps        {s.skip_map_bytes:>12} bytes")
    for layer, count in enumerate(s.slots):
        lines.append(
            f"changes {layer:<2}   {s.change_bytes[layer]:>12} bytes; of {count} slots "
            f"{s.predicted[layer]:.1f} predicted, {s.new[layer]:.1f} new"
        )
    for layer, size in enumerate(s.first_keyframe_bytes):
        joins = s.join_keyframe_bytes[layer]
        lines.append(
            f"keyframes {layer:<2} {size:>12} bytes of frame 0, {joins} bytes for joining players"
        )
    return lines


def verify_objects(reader: StreamReader) -> None:
    """Reads, checks and decodes every object; a keyframe must be what the slices before it have
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
                _check_keyframe(decoder, segment[keyframe_part(layer)], first, layer)
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
    """The slice born at 0 is in the keyframes: its own packets, if any, keep all slots."""
    skip_maps = segment[SKIP_MAPS]
    layers = [segment[layer] for layer in range(decoder.num_layers)]

    def blamed(error: CodecError, layer: int | None) -> CodecError:
        return (skip_maps if layer is None else layers[layer]).blamed(error, 0)

    statuses = decoder.statuses(0, skip_maps.content(0), [one.content(0) for one in layers], blamed)
    if statuses.any():
        error = CorruptError("skip map: the slice born at 0 does not keep all slots")
        raise skip_maps.blamed(error, 0)


def _check_keyframe(decoder: SlotDecoder, found: CheckedObject, frame: int, layer: int) -> None:
    """Raises CorruptError unless the keyframe is what `decoder` holds at `frame`."""
    content = found.content(frame)
    try:
        keyframe = decode_keyframe(decoder.layout, content)
        _check_header(keyframe, frame, layer)
        births = window_births(frame, decoder.layout.swin_size)
        for birth, slots in zip(births, keyframe.lanes, strict=True):
            held = decoder.lanes[decoder.layout.lane(birth)][layer]
            if not _same(held, slots, frame - birth):
                raise CorruptError(
                    f"keyframe: the lane of birth {birth} is not what the slices before it left"
                )
    except CodecError as error:
        raise found.blamed(error, frame) from error


def _check_header(keyframe: Keyframe, frame: int, layer: int) -> None:
    if (keyframe.frame, keyframe.layer) != (frame, layer):
        raise CorruptError(
            f"keyframe: of frame {keyframe.frame} layer {keyframe.layer} where frame {frame} layer "
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


@dataclass(frozen=True, slots=True)
class LayerSummary:
    """Bytes of layers 0..n of a stream together."""

    layers: int
    gaussians_share: float
    """Share of the Gaussians, 0 to 1."""
    size_bytes: int
    """Size of the objects that a player from frame 0 on fetches, with the skip maps and the
    keyframes of frame 0."""
    bitrate_bps: float
    """Bits of them for each second of play."""
    psnr_db: float | None
    """Mean over the frames of the segments whose quality the index knows; None if it knows none."""


@dataclass(frozen=True, slots=True)
class StreamSummary:
    """The report of `swings-stream info`."""

    title: str
    live: bool
    fps: float
    num_frames: int
    duration_s: float
    num_gs: int
    """Slots of all lanes, the most Gaussians that a frame may have."""
    first_gs: int
    """Gaussians in frame 0."""
    bounds: tuple[Point, Point]
    """Lower and upper corner of a box around most Gaussians, metres."""
    swin_size: int
    slice_size: int
    sh_degree: int
    num_cameras: int
    num_segments: int
    segment_frames: int
    size_bytes: int
    """Manifest, index and objects."""
    played_bytes: int
    """The same without the keyframes of later segments, which players fetch that join there."""
    bytes_per_gaussian: float
    """`played_bytes` without manifest and index, over the Gaussians sent: those of frame 0 and all
    that change or are new later."""
    layers: tuple[LayerSummary, ...]
    slots: SlotSummary


def summarise(place: Place, max_gaussians: int | None = DEFAULT_MAX_GAUSSIANS) -> StreamSummary:
    """The summary of the stream at `place`, from its manifest, its index, its skip maps and the
    keyframes of frame 0. max_gaussians: see `check_gaussians`.

    Raises a CodecError.
    """
    return _summary(StreamReader(place, max_gaussians))


def _summary(reader: StreamReader) -> StreamSummary:
    manifest = reader.manifest
    duration_s = reader.num_frames / manifest.fps
    records = reader.records
    census = count_slots(reader)
    layers = layer_summaries(reader)
    gaussians = int(census.brought.sum())
    return StreamSummary(
        title=manifest.title,
        live=manifest.live,
        fps=manifest.fps,
        num_frames=reader.num_frames,
        duration_s=duration_s,
        num_gs=manifest.num_gs,
        first_gs=int(census.first.sum()),
        bounds=manifest.bounds,
        swin_size=manifest.swin_size,
        slice_size=manifest.slice_size,
        sh_degree=manifest.sh_degree,
        num_cameras=len(manifest.cameras),
        num_segments=len(reader.records),
        segment_frames=manifest.segment_frames,
        size_bytes=reader.overhead_bytes + sum(sum(r.part_bytes) for r in records),
        played_bytes=reader.overhead_bytes + layers[-1].size_bytes,
        bytes_per_gaussian=layers[-1].size_bytes / gaussians if gaussians else 0.0,
        layers=layers,
        slots=summarise_slots(reader, census),
    )


def layer_summaries(reader: StreamReader) -> tuple[LayerSummary, ...]:
    """The summary of one layer, of two, ... of all of a stream, from its index alone."""
    manifest, records = reader.manifest, reader.records
    duration_s = reader.num_frames / manifest.fps
    sizes = [_played_bytes(records, n) for n in range(1, manifest.num_layers + 1)]
    return tuple(
        LayerSummary(
            n,
            sum(manifest.layers[:n]),
            size,
            size * 8 / duration_s if duration_s else 0.0,
            _mean_psnr_db(records, n),
        )
        for n, size in enumerate(sizes, start=1)
    )


def _played_bytes(records: list[SegmentRecord], num_layers: int) -> int:
    """Size of the objects that a player of `num_layers` layers from frame 0 on fetches."""
    total = 0
    for record in records:
        total += sum(record.object_bytes[:num_layers]) + sum(record.side_bytes[:1])
        if record.segment == 0:
            total += sum(record.side_bytes[1 : num_layers + 1])
    return total


def _mean_psnr_db(records: list[SegmentRecord], num_layers: int) -> float | None:
    known = [
        (record.psnr_db[num_layers - 1], record.num_frames)
        for record in records
        if not math.isnan(record.psnr_db[num_layers - 1])
    ]
    frames = sum(count for _, count in known)
    return math.fsum(psnr_db * count for psnr_db, count in known) / frames if frames else None


QUALITY_NOTE = (
    "             Bytes count the objects only; dB was recorded in writing, from the held-out\n"
    "             cameras in turn. swings-eval adds manifest and index, and scores all\n"
    "             held-out cameras in every frame"
)
"""Why the figures of the layers are not quite those of swings-eval."""


def describe(summary: StreamSummary) -> str:
    """`summary` for people, one fact on each line."""
    s = summary
    state = "live, may still grow" if s.live else "finished"
    frames = "1 frame" if s.swin_size == 1 else f"{s.swin_size} frames"
    keyframes_bytes = s.size_bytes - s.played_bytes
    size = (
        f"{s.played_bytes} bytes, {s.bytes_per_gaussian:.2f} bytes a Gaussian that is sent; "
        f"{keyframes_bytes} bytes of keyframes for joining players"
    )
    lines = [
        f"title        {s.title or '-'}",
        f"state        {state}",
        f"length       {s.num_frames} frames, {s.duration_s:.1f} s at {s.fps:g} fps",
        f"Gaussians    {s.first_gs} in frame 0, in {s.num_gs} slots with leases of {frames}",
        "bounds       "
        + ", ".join(f"{a} {low:.4g}..{up:.4g}" for a, low, up in zip("xyz", *s.bounds, strict=True))
        + " m",
        f"colour       SH degree {s.sh_degree}",
        f"cameras      {s.num_cameras}",
        f"segments     {s.num_segments} of {s.segment_frames} frames",
        f"size         {size}",
    ]
    lines += [
        f"layers 0..{layer.layers - 1:<2} {layer.size_bytes:>12} bytes"
        f" {layer.bitrate_bps / 1e6:>9.2f} Mbit/s"
        f"  {100 * layer.gaussians_share:>5.1f} % of Gaussians"
        + ("" if layer.psnr_db is None else f"  {layer.psnr_db:>6.2f} dB")
        for layer in s.layers
    ]
    if any(layer.psnr_db is not None for layer in s.layers):
        lines.append(QUALITY_NOTE)
    lines += describe_slots(s.slots)
    return "\n".join(lines)


def verify_stream(place: Place, max_gaussians: int | None = DEFAULT_MAX_GAUSSIANS) -> StreamSummary:
    """The summary of the stream at `place`, after every byte of it was read, checked and decoded.
    max_gaussians: see `check_gaussians`.

    Raises a CodecError for the first thing that is wrong, in the order manifest, index, objects,
    pictures, records of a packed stream. Its message and `at` name the file and the first byte in
    it that may be wrong, as exactly as the format allows: where the manifest stops being JSON, a
    field of the index or of an object's table, the record or the compressed chunk whose checksum or
    content is wrong, or where a file ends too early. Of two fields that contradict each other it is
    the first.
    """
    reader = StreamReader(place, max_gaussians)
    storage, manifest = reader.storage, reader.manifest
    if not isinstance(storage, PackedStorage):  # which has checked it
        index = storage.stamp(INDEX_NAME)
        try:
            check_index_end(0 if index is None else index.size_bytes, manifest, len(reader.records))
        except CodecError as error:
            raise error.within(storage.place(INDEX_NAME)) from error
    verify_objects(reader)
    check_pictures(storage, manifest)
    verify_captions(storage, manifest)
    if manifest.sound:
        from codec.tracks.streamtracks import verify_sound  # PyAV loads slowly

        verify_sound(reader)
    verify_packed(storage)
    return _summary(reader)
