"""From the bytes of chunks to slices, checked against the manifest.

Every source decodes here, so the same stream gives the same pictures wherever it comes from.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from codec.errors import CodecError, CorruptError
from codec.stream.chunk import Chunk
from codec.stream.index import SegmentRecord
from codec.stream.layers import merge_layers
from codec.stream.manifest import Manifest
from codec.stream.object import decode_object_chunk, read_object_table
from player.playout.timeline import ReceivedSlice


def merge_chunks(chunks: Sequence[Chunk], manifest: Manifest, wire_bytes: int) -> ReceivedSlice:
    """The slice of `chunks`, its layers in order. Raises CorruptError if no such stream has it."""
    slice = merge_layers(chunks)
    if (
        slice.splats.sh_degree != manifest.sh_degree
        or len(slice.splats) > manifest.slice_size
        or any(chunk.profile is not manifest.profile for chunk in chunks)
    ):
        raise CorruptError(f"the slice born at {slice.birth} does not fit the manifest")
    return ReceivedSlice(slice, len(chunks), wire_bytes)


def decode_segment(
    manifest: Manifest,
    record: SegmentRecord,
    objects: Sequence[bytes],
    names: Sequence[str],
    first_birth: int,
) -> Iterator[ReceivedSlice]:
    """The slices born at `first_birth` or later, decoded as they are asked for.

    objects: those of layers 0, 1, ...; names: where each came from, for errors.
    """
    births = manifest.births(record.segment, record.num_frames)
    tables = []
    for data, name in zip(objects, names, strict=True):
        try:
            table = read_object_table(data)
        except CodecError as error:
            raise error.within(name) from error
        if [entry.birth for entry in table] != list(births):
            raise CorruptError(f"{name}: its births are not {births[0]}..{births[-1]}")
        tables.append(table)
    for birth in births[max(0, first_birth - births[0]) :]:
        chunks, wire_bytes = [], 0
        for data, name, table in zip(objects, names, tables, strict=True):
            entry = table[birth - births[0]]
            try:
                chunks.append(decode_object_chunk(data, entry, manifest.chunk_bounds))
            except CodecError as error:
                raise error.within(name) from error
            wire_bytes += entry.size
        try:
            yield merge_chunks(chunks, manifest, wire_bytes)
        except CodecError as error:
            raise error.within(names[0]) from error
