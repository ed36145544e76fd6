"""Records of a play, made from the packets of a stream on disk."""

from __future__ import annotations

import tempfile
from pathlib import Path

from codec.stream import StreamReader
from codec.stream.manifest import SKIP_MAPS, keyframe_part
from codec.stream.playrecord import KeyframeRecord, SliceRecord
from tests.support.hosted_streams import SLICE_SIZE, write_stream


def slice_record(reader: StreamReader, birth: int, first: int, end: int) -> SliceRecord:
    """Layers first..end-1 of the slice born at `birth`, with its skip map if layer 0 is
    included."""
    segment = reader.manifest.segment_of(birth)
    parts = (reader.read_object(segment, layer).packet(birth) for layer in range(first, end))
    skip_map = None if first else reader.read_object(segment, SKIP_MAPS).packet(birth)
    return SliceRecord(birth, tuple(parts), skip_map, first)


def keyframe_record(reader: StreamReader, frame: int, first: int, end: int) -> KeyframeRecord:
    """Keyframes of layers first..end-1 at `frame`, the first of a segment."""
    segment = reader.manifest.segment_of(frame)
    parts = map(keyframe_part, range(first, end))
    found = (reader.read_object(segment, part).packet(frame) for part in parts)
    return KeyframeRecord(frame, first, tuple(found))


def records_from_0(
    num_frames: int, slice_size: int = SLICE_SIZE, sh_degree: int = 1
) -> tuple[KeyframeRecord, list[SliceRecord]]:
    """The keyframe of frame 0 and the slices born from 1 on, with all layers, of a stream of
    `small_manifest`."""
    with tempfile.TemporaryDirectory() as folder:
        path = write_stream(Path(folder) / "s", num_frames, slice_size, sh_degree)
        reader = StreamReader(path)
        layers = reader.manifest.num_layers
        slices = [slice_record(reader, birth, 0, layers) for birth in range(1, num_frames)]
        return keyframe_record(reader, 0, 0, layers), slices
