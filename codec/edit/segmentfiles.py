"""The files of a stream that is made of packets: objects, index, manifest."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from codec.files import write_atomic
from codec.stream.manifest import MANIFEST_NAME, OBJECT_URL, Manifest, Part, object_file
from codec.stream.segment import INDEX_NAME, SegmentRecord, join_packets, pack_record

Scores = tuple[float, ...]
"""PSNR in dB of 1, 2, ... layers, as an index record has it."""


class SegmentFiles:
    """Writes the segments of a finished stream to a folder in order; holds the packets of one."""

    def __init__(self, folder: Path, manifest: Manifest) -> None:
        self.folder = folder
        # The objects lie here, whatever other place the manifest of a source names.
        self.manifest = replace(manifest, live=False, object_url=OBJECT_URL)
        self._packets: dict[Part, list[tuple[int, bytes]]] = {}
        self.records: list[SegmentRecord] = []
        """The index records of the segments written so far."""

    @property
    def num_frames(self) -> int:
        """Frames in the segments that are written."""
        return sum(record.num_frames for record in self.records)

    @property
    def num_segments(self) -> int:
        """Segments that are written."""
        return len(self.records)

    @property
    def size_bytes(self) -> int:
        """Bytes of the objects that are written."""
        return sum(sum(record.part_bytes) for record in self.records)

    def put(self, part: Part, birth: int, packet: bytes) -> None:
        """Takes a packet of the segment that is written next; one of no bytes changes nothing."""
        self._packets.setdefault(part, []).append((birth, packet))

    def end_segment(self, num_frames: int, psnr_db: Scores | None) -> None:
        """Writes the packets as the next segment. psnr_db: None if unknown."""
        objects = {part: join_packets(self._packets.get(part, ())) for part in self.manifest.parts}
        self._packets = {}
        self.add(objects, num_frames, psnr_db)

    def add(self, objects: Mapping[Part, bytes], num_frames: int, psnr_db: Scores | None) -> None:
        """Writes the objects of the next segment as they are."""
        segment = len(self.records)
        for part, data in objects.items():
            path = object_file(self.folder, segment, part)
            path.parent.mkdir(parents=True, exist_ok=True)
            write_atomic(path, data)
        data_of_parts = [objects[part] for part in self.manifest.parts]
        first_frame = segment * self.manifest.segment_frames
        record = SegmentRecord.of(data_of_parts, segment, first_frame, num_frames, psnr_db)
        self.records.append(record)

    def finish(self) -> None:
        """Writes index and manifest."""
        write_atomic(self.folder / INDEX_NAME, b"".join(map(pack_record, self.records)))
        write_atomic(self.folder / MANIFEST_NAME, self.manifest.to_json())
