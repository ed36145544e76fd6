"""Data from an untrusted server takes no more memory than its manifest declares."""

from __future__ import annotations

import tracemalloc
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path

import pytest
import zstandard

from codec.errors import CorruptError
from codec.framerange import FrameRange
from codec.stream import StreamReader
from codec.stream.index import pack_record
from codec.stream.manifest import Manifest
from codec.stream.playrecord import LENGTH, Record, SliceRecord, SnapshotRecord
from player.source.opener import opened
from player.source.playreceiver import KEPT_BIRTHS, PlayReceiver
from tests.player.network.webhosts import script
from tests.player.source.test_served import MANIFEST, SLICES, SNAPSHOT, answer, open_play, start
from tests.player.source.test_strange_hosts import endless
from tests.support.delivery.assembled import assembled
from tests.support.hosted_streams import static_host, write_stream


def claiming(size: int) -> bytes:
    """The first part of a packet that claims `size` bytes."""
    compressor = zstandard.ZstdCompressor(write_checksum=True).compressobj(size)
    packet = compressor.compress(bytes(1 << 20))
    return packet + compressor.flush(zstandard.COMPRESSOBJ_FLUSH_BLOCK)


@contextmanager
def at_most(limit_bytes: int) -> Iterator[None]:
    """Fails if the block allocates more than `limit_bytes` at any time."""
    tracemalloc.start()
    try:
        yield
        assert tracemalloc.get_traced_memory()[1] < limit_bytes
    finally:
        tracemalloc.stop()


HUGE = claiming(64 << 20)


@pytest.mark.parametrize(
    ("records", "place"),
    [
        ([SnapshotRecord(0, 0, (HUGE,))], "layer 0 of the snapshot of frame 0"),
        ([SNAPSHOT, SliceRecord(1, (HUGE,), SLICES[0].mask)], "layer 0 of the slice born at 1"),
        ([SNAPSHOT, SliceRecord(1, SLICES[0].packets, HUGE)], "the mask of the slice born at 1"),
    ],
)
def test_a_packet_that_claims_more_than_its_part_can_hold_is_not_inflated(
    records: list[Record], place: str
) -> None:
    with (
        at_most(8 << 20),
        script(answer(start(), *records)) as host,
        closing(open_play(host.url)) as source,
        pytest.raises(CorruptError, match=f"^S: {place}: packet"),
    ):
        list(assembled(source))


def joined(manifest: Manifest = MANIFEST, frames: FrameRange | None = None) -> PlayReceiver:
    """A receiver with the snapshot of frame 0."""
    receiver = PlayReceiver("S", manifest, 3, frames or FrameRange())
    assert receiver.ingest(SNAPSHOT) is not None
    return receiver


def test_what_comes_again_counts_once_and_is_not_held() -> None:
    receiver, whole = joined(), SLICES[0]
    first = SliceRecord(1, whole.packets[:1], whole.mask)
    assert receiver.ingest(first) is not None
    with at_most(100_000):
        for _ in range(1000):
            assert receiver.ingest(first) is None
            assert receiver.ingest(SNAPSHOT) is None
    both = receiver.ingest(SliceRecord(1, whole.packets[:2], whole.mask))
    assert both is not None
    assert both.first_layer == 1
    assert both.packets == whole.packets[1:2]


def test_more_bytes_than_a_packet_can_have_are_not_held() -> None:
    with pytest.raises(CorruptError, match=r"born at 1: packet: 1000000 bytes; the manifest"):
        joined().ingest(SliceRecord(1, (bytes(1_000_000),), b""))


def test_a_record_that_no_slice_fills_is_not_waited_for() -> None:
    begun = answer(start()) + LENGTH.pack(60 << 20)
    with (
        endless(begun, lambda n: bytes(1 << 16)) as url,
        at_most(6 << 20),
        closing(open_play(url)) as source,
        pytest.raises(CorruptError, match=r"a record of 62914560 bytes, at most 1\d{6}$"),
    ):
        list(source.packets())


def test_slices_that_nobody_asked_for_are_not_held() -> None:
    receiver = joined(MANIFEST.with_live(True))
    with at_most(100_000):
        for birth in range(100, 10_000):
            assert receiver.ingest(SliceRecord(birth, (b"zz",), None, 1)) is None
            assert receiver.ingest(SliceRecord(-birth, (b"zz",), b"zz")) is None
    receiver = joined(frames=FrameRange(0, 3))
    with pytest.raises(
        CorruptError, match=r"^S: the slice born at 3 arrived, but the play ends before frame 3"
    ):
        receiver.ingest(SliceRecord(3, (b"zz",), None, 1))


def test_what_has_come_of_an_endless_stream_is_forgotten() -> None:
    receiver = joined(MANIFEST.with_live(True))
    with at_most(6 << 20):
        for birth in range(1, 4 * KEPT_BIRTHS):
            assert receiver.ingest(SliceRecord(birth, (b"zz",), b"zz")) is not None
    assert receiver.ingest(SliceRecord(0, (b"zz",), None, 1)) is None


def test_an_object_that_no_manifest_allows_is_not_fetched(tmp_path: Path) -> None:
    path = write_stream(tmp_path / "s", 13)
    records = StreamReader(path).records
    first = records[0]
    sizes = (1 << 30, *first.object_bytes[1:])
    false = replace(first, object_bytes=sizes)
    (path / "index.bin").write_bytes(pack_record(false) + pack_record(records[1]))
    with static_host(tmp_path) as host:
        for name in (f"{host}/s", str(path)):
            with (
                at_most(8 << 20),
                pytest.raises(CorruptError, match="segment 0 names an object of 1073741824 bytes"),
                opened(name) as source,
            ):
                list(source.packets())
