"""Play records: any split of the bytes gives the same records; hostile ones fail cheaply."""

from __future__ import annotations

import struct
from typing import Any

import msgpack
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from codec.errors import CodecError, CorruptError, InvalidError
from codec.stream.playrecord import (
    MAX_RECORD_BYTES,
    MAX_TEXT_BYTES,
    EndRecord,
    ErrorRecord,
    KeyframeRecord,
    Record,
    RecordParser,
    SliceRecord,
    StartRecord,
    decode_record,
    encode_record,
)
from tests.support.hostile import flips, refused, survives, truncations, within_bytes

frames = st.integers(0, 2**31 - 1)
births = st.integers(-(2**31), 2**31 - 1)
packets = st.binary(max_size=50)


def some(least: int, most: int = 16) -> st.SearchStrategy[tuple[bytes, ...]]:
    return st.lists(packets, min_size=least, max_size=most).map(tuple)


records: st.SearchStrategy[Record] = st.one_of(
    st.builds(StartRecord, frames, frames, st.binary(max_size=50)),
    st.builds(SliceRecord, births, some(0), packets),
    st.builds(SliceRecord, births, some(1, 12), st.none(), st.integers(1, 4)),
    st.builds(KeyframeRecord, frames, st.integers(0, 4), some(1, 12)),
    st.builds(KeyframeRecord, frames, st.just(15), some(1, 1)),
    st.builds(EndRecord, frames),
    st.builds(ErrorRecord, st.text(max_size=100)),
)


def parse(data: bytes) -> list[Record]:
    return RecordParser().feed(data)


@given(st.lists(records, max_size=6), st.lists(st.integers(0, 400), max_size=12))
@settings(max_examples=60)
def test_any_cut_gives_the_same_records(sent: list[Record], cuts: list[int]) -> None:
    data = b"".join(map(encode_record, sent))
    parser = RecordParser()
    received: list[Record] = []
    edges = sorted({0, len(data), *(min(cut, len(data)) for cut in cuts)})
    for start, end in zip(edges, edges[1:] or edges, strict=False):
        received += parser.feed(data[start:end])
    assert received == sent
    assert parser.pending_bytes == 0


def test_the_bytes_are_pinned() -> None:
    record = SliceRecord(-1, (b"ab",), None, 2)
    body = b"\x84\xa4kind\xa5slice\xa5birth\xff\xa7packets\x91\xc4\x02ab\xa5first\x02"
    assert encode_record(record) == struct.pack("<I", len(body)) + body
    record = SliceRecord(3, (), b"m")
    body = b"\x84\xa4kind\xa5slice\xa5birth\x03\xa7packets\x90\xa8skip_map\xc4\x01m"
    assert encode_record(record) == struct.pack("<I", len(body)) + body
    keyframe = msgpack.unpackb(encode_record(KeyframeRecord(30, 2, (b"a", b"b")))[4:])
    assert keyframe == {"kind": "keyframe", "frame": 30, "first": 2, "packets": [b"a", b"b"]}
    start = msgpack.unpackb(encode_record(StartRecord(1, 2, b"m"))[4:])
    assert start == {"kind": "start", "from": 1, "num_frames": 2, "manifest": b"m"}


def test_truncations_wait_and_flips_never_crash() -> None:
    for record in (
        SliceRecord(5, (b"change-1", b"change-2"), None, 1),
        SliceRecord(5, (b"change-0",), b"skip_map"),
        KeyframeRecord(30, 1, (b"keyframe-1",)),
    ):
        data = encode_record(record)
        parser = RecordParser()
        assert [found for byte in data for found in parser.feed(bytes([byte]))] == [record]
        for cut in truncations(data):
            parser = RecordParser()
            assert parser.feed(cut) == []
            assert parser.pending_bytes == len(cut)
        for altered in flips(data):
            survives(parse, altered)


def test_only_a_slice_that_begins_with_layer_0_has_a_skip_map() -> None:
    value: dict[str, Any] = {"kind": "slice", "birth": 1, "packets": [b"a"]}
    with pytest.raises(CorruptError, match="'slice' record without a valid 'skip_map'"):
        decode_record(msgpack.packb(value))
    for masked in ({"first": 0}, {}):
        found = decode_record(msgpack.packb(value | masked | {"skip_map": b"m"}))
        assert found == SliceRecord(1, (b"a",), b"m")
    # In records of the upper layers this is an unknown key.
    for ignored in (b"m", "text", 7, None):
        found = decode_record(msgpack.packb(value | {"first": 2, "skip_map": ignored}))
        assert found == SliceRecord(1, (b"a",), None, 2)


@pytest.mark.parametrize(
    "record",
    [
        SliceRecord(1, (b"",)),
        SliceRecord(1, (b"",), b"skip_map", 1),
        SliceRecord(1, (), None, 1),
        SliceRecord(1, (b"",), b"skip_map", -1),
        SliceRecord(1, (b"",) * 17, b"skip_map"),
        KeyframeRecord(0, 0, ()),
        KeyframeRecord(0, 0, (b"",) * 17),
        KeyframeRecord(0, 16, (b"",)),
        KeyframeRecord(0, 15, (b"",) * 2),
        KeyframeRecord(0, -1, (b"",)),
        KeyframeRecord(-1, 0, (b"",)),
        SliceRecord(1 << 31, (b"",), b"skip_map"),
        EndRecord(1 << 31),
        StartRecord(-1, 0, b""),
    ],
)
def test_what_no_reader_takes_is_not_written(record: Record) -> None:
    refused(InvalidError, "", encode_record, record)


def test_a_record_that_is_too_long_is_refused_at_its_length() -> None:
    refused(CorruptError, "at most", parse, struct.pack("<I", MAX_RECORD_BYTES + 1))
    refused(InvalidError, "", encode_record, StartRecord(0, 1, bytes(MAX_RECORD_BYTES)))


def test_texts_of_errors_have_a_length_and_may_be_no_unicode() -> None:
    for value, good in ((MAX_TEXT_BYTES, True), (MAX_TEXT_BYTES + 1, False)):
        body = b"\x82\xa4kind\xa5error\xa7message\xdb" + value.to_bytes(4, "big") + b"x" * value
        assert survives(decode_record, body) == good
    assert decode_record(encode_record(ErrorRecord("x" * 501))[4:]) == ErrorRecord("x" * 500)
    # A message may name a path whose bytes are not UTF-8.
    body = encode_record(ErrorRecord("lost: \udcff" + "x" * 999))[4:]
    assert decode_record(body) == ErrorRecord("lost: ?" + "x" * 493)


def test_a_tree_of_lists_does_not_grow() -> None:
    tree = b"\x90"
    while len(tree) < 1 << 20:
        tree = b"\xdc\x00\x10" + tree * 16
    for bomb in (b"\x81\xa4kind" + tree, b"\x91" * 5000, b"\x81\xa1k" * 5000, tree):
        with within_bytes(4 << 20), pytest.raises(CodecError):
            decode_record(bomb)
