"""How many bytes a stream's parts can have by its manifest: what is more is refused unread.

Rule: no I/O. The manifest bounds what is decoded; here it bounds what is held compressed, too.
"""

from __future__ import annotations

from codec.errors import CorruptError
from codec.stream.index import SegmentRecord
from codec.stream.manifest import MAX_MANIFEST_BYTES, Manifest, Part, is_snapshot
from codec.stream.object import ENTRY, HEAD

RECORD_BYTES = 4096
"""More than a record has beside its packets, or its manifest."""


class Bounds:
    """What a stream with one manifest can hold."""

    def __init__(self, manifest: Manifest) -> None:
        self._manifest = manifest
        contents = {part: manifest.max_content_bytes(part) for part in manifest.parts}
        self._packet_bytes = {part: _packed(size) for part, size in contents.items()}
        if manifest.has_slots:
            parts = [part for part in contents if not is_snapshot(part)]
            self.slice_bytes = sum(self._packet_bytes[part] for part in parts)
            """Of all packets of a slice together."""
        else:
            # The layers share the Gaussians of one slice.
            self.slice_bytes = _packed(manifest.chunk_bounds.max_bytes)
            self.slice_bytes += manifest.num_layers * _packed(0)

        snapshots = sum(size for part, size in self._packet_bytes.items() if is_snapshot(part))
        self.record_bytes = max(self.slice_bytes, snapshots, MAX_MANIFEST_BYTES) + RECORD_BYTES
        """Of the longest record of a play."""

    def check_packet(self, packet: bytes, part: Part) -> None:
        """Raises CorruptError when `packet` is longer than one of `part` can be."""
        if len(packet) > self._packet_bytes[part]:
            raise CorruptError(
                f"packet: {len(packet)} bytes; the manifest allows {self._packet_bytes[part]}"
            )

    def check_segment(self, record: SegmentRecord) -> None:
        """Raises CorruptError when the index names an object that is longer than one can be."""
        manifest, all_bytes, all_limit = self._manifest, 0, 0
        for number, part in enumerate(manifest.parts):
            births = len(manifest.part_births(record.segment, record.num_frames, part))
            table = HEAD.size + ENTRY.size * births
            size, limit = record.part_bytes[number], table + births * self._packet_bytes[part]
            all_bytes += size
            all_limit += table if not manifest.has_slots else limit
            if size > limit:
                raise CorruptError(
                    f"index: segment {record.segment} names an object of {size} bytes, "
                    f"but the manifest allows {limit}"
                )
        if not manifest.has_slots:
            births = len(manifest.births(record.segment, record.num_frames))
            all_limit += births * self.slice_bytes
        if all_bytes > all_limit:
            raise CorruptError(
                f"index: segment {record.segment} has {all_bytes} bytes, "
                f"but the manifest allows {all_limit}"
            )


def _packed(content_bytes: int) -> int:
    """The longest packet of so much content: no coder shortens everything."""
    return content_bytes + content_bytes // 64 + 4096
