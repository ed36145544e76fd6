"""What no writer of ours makes: bytes for tests of those who read what others wrote."""

from __future__ import annotations

import zlib

from codec.stream.index import CHECKSUM, HEAD, LAYER, SegmentRecord


def forged_record(record: SegmentRecord) -> bytes:
    """A record of the index with a right checksum, whatever rule it breaks."""
    body = HEAD.pack(record.segment, record.first_frame, record.num_frames, 0) + b"".join(
        LAYER.pack(*layer)
        for layer in zip(record.object_bytes, record.object_sha256, record.psnr_db, strict=True)
    )
    return body + CHECKSUM.pack(zlib.crc32(body))
