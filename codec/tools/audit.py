"""Contents and integrity of a stream: `swings-stream info` and `verify`."""

from __future__ import annotations

import math
from dataclasses import dataclass

from codec.errors import CodecError
from codec.storage.openstorage import Place
from codec.stream.index import INDEX_NAME, SegmentRecord
from codec.stream.integrity import check_index_end
from codec.stream.manifest import Point
from codec.stream.packedstorage import PackedStorage
from codec.stream.pictures import check_pictures
from codec.stream.reader import DEFAULT_MAX_GAUSSIANS, StreamReader
from codec.tracks.streamtracks import verify_captions

from .objectaudit import verify_objects
from .packing import verify_packed
from .slotcensus import SlotSummary, count_slots, describe_slots, summarise_slots


@dataclass(frozen=True, slots=True)
class LayerSummary:
    """Bytes of layers 0..n of a stream together."""

    layers: int
    gaussians_share: float
    """Share of the Gaussians, 0 to 1."""
    size_bytes: int
    """Size of the objects that a player from frame 0 on fetches, with the masks and the snapshots
    of frame 0."""
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
    """The same without the snapshots of later segments, which players fetch that join there."""
    bytes_per_gaussian: float
    """`played_bytes` without manifest and index, over the Gaussians sent: those of frame 0 and all
    that change or are new later."""
    layers: tuple[LayerSummary, ...]
    slots: SlotSummary


def summarise(place: Place, max_gaussians: int | None = DEFAULT_MAX_GAUSSIANS) -> StreamSummary:
    """The summary of the stream at `place`, from its manifest, its index, its masks and the
    snapshots of frame 0. max_gaussians: see `check_gaussians`.

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
    snapshots_bytes = s.size_bytes - s.played_bytes
    size = (
        f"{s.played_bytes} bytes, {s.bytes_per_gaussian:.2f} bytes a Gaussian that is sent; "
        f"{snapshots_bytes} bytes of snapshots for joining players"
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
        from codec.tracks.streamsound import verify_sound  # PyAV loads slowly

        verify_sound(reader)
    verify_packed(storage)
    return _summary(reader)
