"""index.bin: pinned records; torn tails are ignored, anything else is refused."""

from __future__ import annotations

import math
import struct
import zlib
from dataclasses import replace

import pytest

from codec.errors import CorruptError, InvalidError
from codec.stream.index import SegmentRecord, pack_record, parse_index, record_bytes
from tests.support.hostile import flips

LAYERS = 3


def record(segment: int, num_frames: int = 30) -> SegmentRecord:
    return SegmentRecord(
        segment,
        30 * segment,
        num_frames,
        tuple(1000 * segment + layer for layer in range(LAYERS)),
        tuple(bytes([segment, layer] * 16) for layer in range(LAYERS)),
        (30.5, 31.25, 32.0),
        tuple(500 * segment + number for number in range(LAYERS + 1)),
        tuple(bytes([segment, 9, number, 9] * 8) for number in range(LAYERS + 1)),
    )


RECORDS = [record(0), record(1), record(2, 7)]
INDEX = b"".join(map(pack_record, RECORDS))


def test_records_round_trip() -> None:
    assert parse_index(INDEX, LAYERS) == RECORDS
    assert parse_index(b"", LAYERS) == []
    unknown = replace(RECORDS[0], psnr_db=(math.nan,) * LAYERS)
    (found,) = parse_index(pack_record(unknown), LAYERS)
    assert all(math.isnan(psnr) for psnr in found.psnr_db)
    for layers in (0, 17):
        with pytest.raises(InvalidError):
            record_bytes(layers)
    assert parse_index(INDEX[record_bytes(LAYERS) :], LAYERS, first_segment=1) == RECORDS[1:]


def test_the_record_is_pinned() -> None:
    assert [record_bytes(n) for n in (1, 4, 16)] == [60 + 84 * n for n in (1, 4, 16)]
    data = pack_record(RECORDS[2])
    assert struct.unpack_from("<IIII", data) == (2, 60, 7, 0)
    assert struct.unpack_from("<Q32sf", data, 16 + 44) == (2001, bytes([2, 1] * 16), 31.25)
    masks = 16 + 44 * 3
    assert struct.unpack_from("<Q32s", data, masks) == (1000, bytes([2, 9, 0, 9] * 8))
    assert struct.unpack_from("<Q32s", data, masks + 3 * 40) == (1003, bytes([2, 9, 3, 9] * 8))
    assert struct.unpack_from("<I", data, masks + 4 * 40) == (zlib.crc32(data[:-4]),)


def test_only_the_snapshots_of_the_first_segment_are_played() -> None:
    assert RECORDS[1].part_bytes == (1000, 1001, 1002, 500, 501, 502, 503)
    assert RECORDS[1].played_bytes == 1000 + 1001 + 1002 + 500
    assert RECORDS[0].played_bytes == sum(RECORDS[0].part_bytes)
    assert len(RECORDS[0].part_sha256) == len(RECORDS[0].part_bytes)


def test_a_torn_last_record_is_left_out_at_any_byte() -> None:
    size = record_bytes(LAYERS)
    for length in range(len(INDEX)):
        assert parse_index(INDEX[:length], LAYERS) == RECORDS[: length // size]
    assert parse_index(INDEX + bytes(size), LAYERS) == RECORDS
    assert parse_index(INDEX + bytes(size - 1), LAYERS) == RECORDS


def test_any_altered_byte_is_found() -> None:
    for altered in flips(INDEX):
        with pytest.raises(CorruptError, match="segment"):
            parse_index(altered, LAYERS)


@pytest.mark.parametrize(
    "wrong",
    [
        replace(RECORDS[0], object_bytes=(1, 2)),
        replace(RECORDS[0], object_bytes=(1, -2, 3)),
        replace(RECORDS[0], object_sha256=(b"short",) * LAYERS),
        replace(RECORDS[0], side_bytes=(1, 2, 3), side_sha256=(bytes(32),) * 3),
        replace(RECORDS[0], side_bytes=(1, 2, 3, -4)),
        replace(RECORDS[0], side_sha256=(b"short",) * (LAYERS + 1)),
        replace(RECORDS[0], num_frames=1 << 32),
        replace(RECORDS[0], psnr_db=(1e300,) * LAYERS),
        replace(RECORDS[0], psnr_db=(30.0, math.inf, 30.0)),
        replace(RECORDS[0], psnr_db=(-math.inf, math.nan, 30.0)),
    ],
)
def test_what_does_not_fit_is_not_packed(wrong: SegmentRecord) -> None:
    with pytest.raises(InvalidError):
        pack_record(wrong)
