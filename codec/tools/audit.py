"""What a stream holds and whether it holds together: `swings-stream info` and `verify`."""

from __future__ import annotations

import math
from dataclasses import dataclass

from codec.errors import CodecError
from codec.splats import DRAWN_SH_DEGREE
from codec.storage.openstorage import Place
from codec.stream.index import INDEX_NAME, SegmentRecord
from codec.stream.integrity import (
    check_index_end,
    check_object_bytes,
    check_slice_size,
    decode_fitting_chunk,
    object_table,
)
from codec.stream.manifest import object_name
from codec.stream.object import MAX_OBJECT_BYTES
from codec.stream.poster import check_poster
from codec.stream.reader import DEFAULT_MAX_GAUSSIANS, StreamReader, read_stream_file

from .slotaudit import verify_slots
from .slotcensus import SlotSummary, count_slots, describe_slots, summarise_slots


@dataclass(frozen=True, slots=True)
class LayerSummary:
    """What layers 0..n of a stream cost together."""

    layers: int
    gaussians_share: float
    """Share of the Gaussians, 0 to 1."""
    size_bytes: int
    """Of the objects that one fetches who plays from frame 0; in version 2 with the masks and the
    snapshots of frame 0."""
    bitrate_bps: float
    """Bits of them for each second of play."""
    psnr_db: float | None
    """Mean over the frames of the segments whose quality the index knows; None if it knows none."""


@dataclass(frozen=True, slots=True)
class StreamSummary:
    """What `swings-stream info` says of a stream."""

    title: str
    profile: str
    live: bool
    fps: float
    num_frames: int
    duration_s: float
    num_gs: int
    swin_size: int
    slice_size: int
    sh_degree: int
    num_cameras: int
    num_segments: int
    segment_frames: int
    size_bytes: int
    """Manifest, index and objects."""
    played_bytes: int
    """What of them one fetches who plays from frame 0: less than all only in version 2, where
    snapshots are for those who join later."""
    bytes_per_gaussian: float
    """Of the objects that one fetches who plays from frame 0, over the Gaussians that they bring:
    in version 1 those that all slices would have at full count, in version 2 those of frame 0 and
    all that change or are new later."""
    layers: tuple[LayerSummary, ...]
    slots: SlotSummary | None
    """Only in version 2."""


def summarise(place: Place, max_gaussians: int | None = DEFAULT_MAX_GAUSSIANS) -> StreamSummary:
    """The summary of the stream at `place`, from its manifest and index; in version 2 also from its
    masks and the snapshots of frame 0. max_gaussians: see `check_gaussians`.

    Raises a CodecError.
    """
    return _summary(StreamReader(place, max_gaussians))


def _summary(reader: StreamReader) -> StreamSummary:
    manifest = reader.manifest
    duration_s = reader.num_frames / manifest.fps
    records = reader.records
    census = count_slots(reader) if manifest.has_slots else None
    sizes = [_played_bytes(records, n) for n in range(1, manifest.num_layers + 1)]
    layers = tuple(
        LayerSummary(
            n,
            sum(manifest.layers[:n]),
            size,
            size * 8 / duration_s if duration_s else 0.0,
            _mean_psnr_db(records, n),
        )
        for n, size in enumerate(sizes, start=1)
    )
    if census is None:
        num_slices = reader.num_frames + manifest.swin_size - 1 if reader.num_frames else 0
        gaussians = num_slices * manifest.slice_size
    else:
        gaussians = int(census.brought.sum())
    return StreamSummary(
        title=manifest.title,
        profile=manifest.profile.value,
        live=manifest.live,
        fps=manifest.fps,
        num_frames=reader.num_frames,
        duration_s=duration_s,
        num_gs=manifest.num_gs,
        swin_size=manifest.swin_size,
        slice_size=manifest.slice_size,
        sh_degree=manifest.sh_degree,
        num_cameras=len(manifest.cameras),
        num_segments=len(reader.records),
        segment_frames=manifest.segment_frames,
        size_bytes=reader.overhead_bytes + sum(sum(r.part_bytes) for r in records),
        played_bytes=reader.overhead_bytes + sizes[-1],
        bytes_per_gaussian=sizes[-1] / gaussians if gaussians else 0.0,
        layers=layers,
        slots=None if census is None else summarise_slots(reader, census),
    )


def _played_bytes(records: list[SegmentRecord], num_layers: int) -> int:
    """Of the objects that one fetches who plays `num_layers` layers from frame 0."""
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
    "             Bytes count the objects only; dB was recorded in writing, from one held-out\n"
    "             camera a frame, in turn. swings-eval adds manifest and index, and scores all\n"
    "             held-out cameras in every frame"
)
"""Why the figures of the layers are not quite those of swings-eval."""


def describe(summary: StreamSummary) -> str:
    """`summary` for people, one fact on each line."""
    s = summary
    state = "live, may still grow" if s.live else "finished"
    frames = "1 frame" if s.swin_size == 1 else f"{s.swin_size} frames"
    share = f"{s.slice_size} a slice, live {frames}"
    undrawn = ""
    if s.sh_degree > DRAWN_SH_DEGREE:
        undrawn = f", of which players draw degree {DRAWN_SH_DEGREE}; exports keep all"
    size = f"{s.played_bytes} bytes, {s.bytes_per_gaussian:.2f} bytes a Gaussian"
    if s.slots is not None:
        share = f"in leases of {frames}"
        snapshots_bytes = s.size_bytes - s.played_bytes
        size += f" that is sent; {snapshots_bytes} bytes of snapshots for joining players"
    lines = [
        f"title        {s.title or '-'}",
        f"state        {state}",
        f"length       {s.num_frames} frames, {s.duration_s:.1f} s at {s.fps:g} fps",
        f"Gaussians    {s.num_gs} active, {share}",
        f"colour       SH degree {s.sh_degree}{undrawn}",
        f"profile      {s.profile}",
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
    if s.slots is not None:
        lines += describe_slots(s.slots)
    return "\n".join(lines)


def verify_stream(place: Place, max_gaussians: int | None = DEFAULT_MAX_GAUSSIANS) -> StreamSummary:
    """The summary of the stream at `place`, after every byte of it was read, checked and decoded.
    max_gaussians: see `check_gaussians`.

    Raises a CodecError for the first thing that is wrong, in the order manifest, index, objects,
    poster. Its message and `at` name the file and the first byte in it that may be wrong, as
    exactly as the format tells: where the manifest stops being JSON, a field of the index or of an
    object's table, the record or the compressed chunk whose checksum or content is wrong, or where
    a file ends too early. Of two fields that contradict each other it is the first.
    """
    reader = StreamReader(place, max_gaussians)
    storage, manifest = reader.storage, reader.manifest
    index = storage.stamp(INDEX_NAME)
    try:
        check_index_end(0 if index is None else index.size_bytes, manifest, len(reader.records))
    except CodecError as error:
        raise error.within(storage.place(INDEX_NAME)) from error
    if manifest.has_slots:
        verify_slots(reader)
    else:
        _verify_slices(reader)
    check_poster(storage, manifest)
    return _summary(reader)


def _verify_slices(reader: StreamReader) -> None:
    """Raises a CodecError for the first object that is wrong (version 1)."""
    manifest = reader.manifest
    for record in reader.records:
        births = manifest.births(record.segment, record.num_frames)
        totals = [0] * len(births)
        for layer in range(manifest.num_layers):
            counts = _verify_object(reader, record, layer)
            totals = [total + count for total, count in zip(totals, counts, strict=True)]
            try:
                for birth, total in zip(births, totals, strict=True):
                    check_slice_size(birth, total, manifest)
            except CodecError as error:
                raise error.within(reader.object_place(record.segment, layer)) from error


def _verify_object(reader: StreamReader, record: SegmentRecord, layer: int) -> list[int]:
    """How many Gaussians each chunk of an object has. Raises a CodecError that says the place."""
    place = reader.object_place(record.segment, layer)
    data = read_stream_file(reader.storage, object_name(record.segment, layer), MAX_OBJECT_BYTES)
    damage: CodecError | None = None
    try:
        check_object_bytes(data, record, layer)
    except CodecError as error:
        damage = error
    try:
        counts = _decode_all(reader, record, layer, data)
    except CodecError as error:
        # What was altered is told by its table or its chunks: a hash does not say where.
        told = error if damage is None else error.reworded(f"was altered: {error}", error.at)
        raise told.within(place) from error
    if damage is not None:
        raise damage.within(place)
    return counts


def _decode_all(reader: StreamReader, record: SegmentRecord, layer: int, data: bytes) -> list[int]:
    """How many Gaussians each chunk of the object `data` has."""
    manifest = reader.manifest
    return [
        len(decode_fitting_chunk(data, entry, manifest, layer).slice.splats)
        for entry in object_table(data, manifest, record, layer)
    ]
