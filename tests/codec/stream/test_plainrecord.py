"""Records for browsers: their body, decoded, is the records with chunks in place of packets."""

from __future__ import annotations

import io
from collections.abc import Callable

import pytest
import zstandard
from hypothesis import given, settings
from hypothesis import strategies as st

from codec.coders.coder import Coder, compress
from codec.errors import CodecError, CorruptError
from codec.stream.plainrecord import MAX_WINDOW_BYTES, PlainRecordEncoder
from codec.stream.playrecord import (
    EndRecord,
    ErrorRecord,
    Record,
    RecordParser,
    SliceRecord,
    SnapshotRecord,
    StartRecord,
    encode_record,
)
from tests.support.hostile import flips, survives, truncations

contents = st.one_of(
    st.binary(max_size=400),
    st.builds(lambda byte, n: byte * n, st.binary(min_size=1, max_size=1), st.integers(1, 70_000)),
)
packed = st.tuples(contents, st.sampled_from(Coder))
Packed = tuple[bytes, Coder]


def inflated(body: bytes) -> bytes:
    """What a browser makes of a body of Content-Encoding: zstd."""
    reader = zstandard.ZstdDecompressor().stream_reader(io.BytesIO(body), read_across_frames=True)
    return reader.read()


def packet(one: Packed) -> bytes:
    """A packet; of no bytes where nothing changes."""
    content, coder = one
    return compress(content, (), coder) if content else b""


def plain(one: Packed) -> bytes:
    """The same in a body for browsers."""
    return packet(one) if one[1] is Coder.GZIP else one[0]


def made(
    kind: str,
    birth: int,
    layers: list[Packed],
    mask: Packed | None,
    write: Callable[[Packed], bytes],
) -> Record:
    packets = tuple(map(write, layers))
    if kind == "snapshot":
        return SnapshotRecord(birth, 3, packets)
    if mask is not None:
        return SliceRecord(birth, packets, write(mask))
    return SliceRecord(birth, packets, None, 2)


@given(
    st.sampled_from(["slice", "snapshot"]),
    st.integers(0, 2**31 - 1),
    st.lists(packed, min_size=1, max_size=4),
    st.none() | packed,
    st.booleans(),
)
@settings(max_examples=150, deadline=None)
def test_packets_come_as_their_content(
    kind: str, birth: int, layers: list[Packed], mask: Packed | None, zstd_encoded: bool
) -> None:
    body = PlainRecordEncoder(zstd_encoded).encode(made(kind, birth, layers, mask, packet))
    decoded = inflated(body) if zstd_encoded else body
    assert RecordParser().feed(decoded) == [made(kind, birth, layers, mask, plain)]


@given(
    st.one_of(
        st.builds(StartRecord, st.integers(0, 99), st.integers(0, 99), st.binary(max_size=5000)),
        st.builds(EndRecord, st.integers(0, 99)),
        st.builds(ErrorRecord, st.text(max_size=50)),
    )
)
def test_records_without_packets_are_the_same(record: Record) -> None:
    assert PlainRecordEncoder(False).encode(record) == encode_record(record)
    assert inflated(PlainRecordEncoder(True).encode(record)) == encode_record(record)


@pytest.mark.parametrize("zstd_encoded", [False, True])
def test_a_packet_goes_out_as_it_is_stored(zstd_encoded: bool) -> None:
    stored = compress(bytes(range(256)) * 40)
    body = PlainRecordEncoder(zstd_encoded).encode(SliceRecord(7, (stored,)))
    assert (stored in body) == zstd_encoded


@pytest.mark.parametrize("zstd_encoded", [False, True])
def test_packets_that_are_none_are_refused(zstd_encoded: bool) -> None:
    encode = PlainRecordEncoder(zstd_encoded).encode
    good = compress(b"what is in it")
    for bad in [*truncations(good), *flips(good)]:
        if bad:
            survives(lambda data: encode(SliceRecord(0, (data,))), bad)
    with pytest.raises(CorruptError, match="neither a zstd frame nor a gzip member"):
        encode(SliceRecord(0, (b"something else",)))
    with pytest.raises(CodecError, match="at most"):
        encode(SliceRecord(0, (compress(bytes(MAX_WINDOW_BYTES + 1)),)))
