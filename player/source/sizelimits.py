"""How many bytes a stream's parts can have by its manifest: what is more is refused unread.

Rule: no I/O. The manifest bounds what is decoded; here it bounds what is held compressed, too.
"""

from __future__ import annotations

from codec.errors import CorruptError
from codec.stream.manifest import MAX_MANIFEST_BYTES, Manifest, Part, is_keyframe
from codec.stream.segment import ENTRY, OBJECT_HEAD, SegmentRecord

RECORD_BYTES = 4096
"""More than a record has beside its packets, or its manifest."""


class SizeLimits:
    """Largest sizes of the parts of a stream with one manifest."""

    def __init__(self, manifest: Manifest) -> None:
        self._manifest = manifest
        contents = {part: manifest.max_content_bytes(part) for part in manifest.parts}
        self._packet_bytes = {part: _packed(size) for part, size in contents.items()}
        keyframes = sum(size for part, size in self._packet_bytes.items() if is_keyframe(part))
        slices = sum(self._packet_bytes.values()) - keyframes
        self.record_bytes = max(slices, keyframes, MAX_MANIFEST_BYTES) + RECORD_BYTES
        """Longest record of a play, bytes."""

    def check_packet(self, packet: bytes, part: Part) -> None:
        """Raises CorruptError when `packet` is longer than one of `part` can be."""
        if len(packet) > self._packet_bytes[part]:
            raise CorruptError(
                f"packet: {len(packet)} bytes; the manifest allows {self._packet_bytes[part]}"
            )

    def check_segment(self, record: SegmentRecord) -> None:
        """Raises CorruptError when the index names an object that is longer than one can be."""
        for part, size in zip(self._manifest.parts, record.part_bytes, strict=True):
            births = len(self._manifest.part_births(record.segment, record.num_frames, part))
            limit = OBJECT_HEAD.size + births * (ENTRY.size + self._packet_bytes[part])
            if size > limit:
                raise CorruptError(
                    f"index: segment {record.segment} names an object of {size} bytes, "
                    f"but the manifest allows {limit}"
                )


def _packed(content_bytes: int) -> int:
    """The longest packet of so much content: no coder shortens everything."""
    return content_bytes + content_bytes // 64 + 4096
