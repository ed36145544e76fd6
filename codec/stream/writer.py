"""Writes the folder of a stream so that a reader always sees a valid, shorter stream.

Rule: an object is whole on disk (temporary name, fsync, rename) before the index record
that names it is appended (fsync). Killing the writer at any instant loses at most the segment being
written.
"""

from __future__ import annotations

import hashlib
import math
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from types import TracebackType

from codec.errors import InvalidError
from codec.files import append_durably, sync_folder, temporary_beside, write_atomic
from codec.slice import Slice

from .chunk import Chunk, encode_chunk
from .index import INDEX_NAME, SegmentRecord, pack_record, record_bytes
from .layers import RANKS, Rank, split_layers
from .manifest import MANIFEST_NAME, SEGMENTS_NAME, Manifest, object_file
from .object import decode_packet, encode_packet, join_packets
from .reader import StreamReader

Quality = Callable[[Sequence[Chunk]], Sequence[float] | None]
"""Takes the decoded chunks of a slice, layer 0 first. Gives the PSNR in dB of the frame that the
slice is born in, with 1, 2, ... layers; None for a slice born before frame 0."""


def _is_unused(path: Path) -> bool:
    """Whether the folder `path` holds nothing but what a killed `create` may have left."""
    leftovers = [temporary_beside(path / name) for name in (INDEX_NAME, MANIFEST_NAME)]
    return all(
        (entry.name == INDEX_NAME and not entry.stat().st_size)
        or (entry.name == SEGMENTS_NAME and entry.is_dir() and not any(entry.iterdir()))
        or entry in leftovers
        for entry in path.iterdir()
    )


class StreamWriter:
    """Appends slices to a stream; holds the compressed chunks of one segment at most.

    Use it with `with`: leaving normally closes the stream, leaving by an exception aborts it, which
    keeps the finished segments and leaves the stream live for `resume`.
    """

    def __init__(
        self,
        path: Path,
        manifest: Manifest,
        records: list[SegmentRecord],
        rank: Rank,
        quality: Quality | None,
    ) -> None:
        """Use `create` or `resume`."""
        if rank not in RANKS:  # a string of a caller whose types nobody checks
            raise InvalidError(f"no rank is called {rank!r}; there are {', '.join(RANKS)}")
        self.path = path
        self.manifest = manifest
        self._rank = RANKS[rank]
        self._quality = quality
        self._scores_db: list[tuple[float, ...]] = []
        self._num_segments = len(records)
        self._packets: list[list[tuple[int, bytes]]] = [[] for _ in manifest.layers]
        self._closed = False
        self.next_birth = (
            records[-1].first_frame + records[-1].num_frames if records else manifest.first_birth
        )
        """Birth of the slice that `append` wants next."""
        self.bytes_written = sum(sum(record.object_bytes) for record in records)
        """Bytes of the finished segments' objects."""

    @classmethod
    def create(
        cls,
        path: Path,
        manifest: Manifest,
        rank: Rank = Rank.OPACITY,
        quality: Quality | None = None,
    ) -> StreamWriter:
        """A writer of a new stream at `path`, which is absent, an empty folder, or one where a
        writer was killed before it was a stream.

        `rank` orders the Gaussians of each slice into layers. `quality` scores every frame; the
        index holds its mean over each segment, or NaN without it.
        """
        if path.exists() and not (path.is_dir() and _is_unused(path)):
            raise InvalidError(f"{path} is not empty; remove it or name another folder")
        writer = cls(path, manifest.with_live(True), [], rank, quality)
        described = writer.manifest.to_json()  # before anything is written: it may be refused
        path.mkdir(parents=True, exist_ok=True)
        (path / SEGMENTS_NAME).mkdir(exist_ok=True)
        write_atomic(path / INDEX_NAME, b"")
        # Last, because a folder is a stream from the moment that it has a manifest.
        write_atomic(path / MANIFEST_NAME, described)
        return writer

    @classmethod
    def resume(
        cls,
        path: Path,
        rank: Rank = Rank.OPACITY,
        quality: Quality | None = None,
    ) -> StreamWriter:
        """A writer that goes on after `path`'s last finished segment; `next_birth` says where."""
        reader = StreamReader(path)
        manifest, records = reader.manifest, reader.records
        if not manifest.live:
            raise InvalidError(f"{path} is finished; write to another folder")
        # Takes off what a killed writer left after the last whole record.
        os.truncate(path / INDEX_NAME, len(records) * record_bytes(manifest.num_layers))
        for leftover in (*path.glob(".*.tmp"), *(path / SEGMENTS_NAME).glob("*/.*.tmp")):
            leftover.unlink()
        return cls(path, manifest, records, rank, quality)

    @property
    def complete(self) -> bool:
        """Whether a short last segment stands already, after which nothing can be appended."""
        return self._num_segments * self.manifest.segment_frames > max(self.next_birth, 0)

    @property
    def durable_birth(self) -> int:
        """Births below this one lie in finished segments; the others are lost by a kill."""
        if not self._num_segments:
            return self.manifest.first_birth
        return min(self.next_birth, self._num_segments * self.manifest.segment_frames)

    def append(self, slice: Slice) -> None:
        """Takes the slice born at `next_birth`; writes the segment that it completes.

        If it raises, nothing of the slice is kept: the same one, or another, may be tried again.
        """
        manifest = self.manifest
        if self._closed:
            raise InvalidError(f"{self.path}: the writer is closed")
        if slice.birth != self.next_birth:
            raise InvalidError(
                f"{self.path}: slice born at {slice.birth}, expected {self.next_birth}"
            )
        if self.complete:
            raise InvalidError(f"{self.path}: the last segment is short; nothing can follow it")
        if len(slice.splats) > manifest.slice_size:
            raise InvalidError(
                f"{self.path}: {len(slice.splats)} Gaussians, at most {manifest.slice_size} a slice"
            )
        if slice.splats.sh_degree != manifest.sh_degree:
            raise InvalidError(
                f"{self.path}: SH degree {slice.splats.sh_degree}, not {manifest.sh_degree}"
            )
        parts = split_layers(slice, manifest.layers, self._rank)
        steps = manifest.profile.coding.layer_steps([part.splats for part in parts])
        encoded = [
            encode_packet(encode_chunk(part, layer, manifest.profile, steps[layer]))
            for layer, part in enumerate(parts)
        ]
        scores_db = [*self._scores_db, *self._measure(encoded)]
        packets = [
            [*kept, (slice.birth, packet)]
            for kept, packet in zip(self._packets, encoded, strict=True)
        ]
        next_birth = slice.birth + 1
        if next_birth == (self._num_segments + 1) * manifest.segment_frames:
            self._write_segment(packets, scores_db, next_birth)
        else:
            self._packets, self._scores_db, self.next_birth = packets, scores_db, next_birth

    def _measure(self, packets: Sequence[bytes]) -> list[tuple[float, ...]]:
        """The scores of a slice, if it has any: of the bytes as they are, not of what was given."""
        if self._quality is None:
            return []
        scores_db = self._quality([decode_packet(packet) for packet in packets])
        if scores_db is None:
            return []
        if len(scores_db) != len(packets) or any(map(math.isinf, scores_db)):
            raise InvalidError(
                f"{self.path}: a quality of {tuple(scores_db)} dB is not {len(packets)} numbers, "
                "each finite, or NaN where unknown"
            )
        return [tuple(scores_db)]

    def _write_segment(
        self,
        packets: list[list[tuple[int, bytes]]],
        scores_db: list[tuple[float, ...]],
        next_birth: int,
    ) -> None:
        """Writes the segment of `packets`; only then takes note of it, so that it may fail."""
        segment = self._num_segments
        first_frame = segment * self.manifest.segment_frames
        objects = [join_packets(of_layer) for of_layer in packets]
        for layer, data in enumerate(objects):
            path = object_file(self.path, segment, layer)
            path.parent.mkdir(exist_ok=True)
            write_atomic(path, data)
        sync_folder(self.path / SEGMENTS_NAME)
        record = SegmentRecord(
            segment,
            first_frame,
            next_birth - first_frame,
            tuple(len(data) for data in objects),
            tuple(hashlib.sha256(data).digest() for data in objects),
            self._mean(scores_db),
        )
        index_bytes = segment * record_bytes(self.manifest.num_layers)
        append_durably(self.path / INDEX_NAME, index_bytes, pack_record(record))
        self._num_segments += 1
        self.next_birth = next_birth
        self.bytes_written += sum(record.object_bytes)
        self._drop()

    def _drop(self) -> None:
        self._packets = [[] for _ in self.manifest.layers]
        self._scores_db = []

    def _mean(self, scores_db: list[tuple[float, ...]]) -> tuple[float, ...]:
        """The mean over the frames, for each number of layers."""
        if not scores_db:
            return (math.nan,) * self.manifest.num_layers
        columns = zip(*scores_db, strict=True)
        return tuple(math.fsum(column) / len(column) for column in columns)

    def close(self) -> None:
        """Writes the short last segment, if there is one, and marks the stream as finished."""
        if self._closed:
            return
        if self._packets[0] and self.next_birth > 0:
            self._write_segment(self._packets, self._scores_db, self.next_birth)
        finished = self.manifest.with_live(False)
        write_atomic(self.path / MANIFEST_NAME, finished.to_json())
        self.manifest = finished
        self._closed = True  # only now: what failed above may be tried again

    def abort(self) -> None:
        """Drops the unfinished segment and leaves the stream live."""
        self._closed = True
        self._drop()

    def __enter__(self) -> StreamWriter:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        if kind is None:
            self.close()
        else:
            self.abort()
