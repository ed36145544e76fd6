"""What a stranger's server sends costs no more memory than its manifest declares."""

from __future__ import annotations

import tracemalloc
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import zstandard

from codec.errors import CorruptError
from codec.framerange import FrameRange
from codec.slice import Slice
from codec.splats import Splats, array_shapes
from codec.stream import StreamReader
from codec.stream.chunk import encode_chunk
from codec.stream.index import pack_record
from codec.stream.manifest import Manifest
from codec.stream.object import encode_packet
from codec.stream.playrecord import LENGTH, Record, SliceRecord
from player.source.opener import opened
from player.source.receiver import KEPT_BIRTHS, Receiver
from tests.player.source.test_served import answer, open_play, script, start
from tests.player.source.test_strange_hosts import endless
from tests.support.delivery.assembled import assembled
from tests.support.hosted_streams import SWIN_SIZE, small_manifest, static_host, write_stream

LAYERS = 16
SLICE_SIZE = 20_000
SLICE_BYTES = SLICE_SIZE * (4 * 23 + 1)
"""Of a decoded slice of SH degree 1."""

MANIFEST = small_manifest(SLICE_SIZE, layers=(1 / LAYERS,) * LAYERS)


def full_layer(birth: int, layer: int, count: int = SLICE_SIZE) -> bytes:
    """The packet of a layer that alone holds `count` Gaussians, in next to no bytes."""
    arrays = [np.ones(shape, np.float32) for shape in array_shapes(count, 1)]
    slice = Slice(birth, Splats(*arrays), np.zeros(count, np.uint8))
    return encode_packet(encode_chunk(slice, layer, MANIFEST.profile))


def claiming(size: int) -> bytes:
    """A packet that says it holds `size` bytes, and has the first ones."""
    compressor = zstandard.ZstdCompressor(write_checksum=True).compressobj(size)
    packet = compressor.compress(bytes(1 << 20))
    return packet + compressor.flush(zstandard.COMPRESSOBJ_FLUSH_BLOCK)


@contextmanager
def at_most(limit_bytes: int) -> Iterator[None]:
    """Fails when more than `limit_bytes` are held at some time, beyond what is held already."""
    tracemalloc.start()
    try:
        yield
        assert tracemalloc.get_traced_memory()[1] < limit_bytes
    finally:
        tracemalloc.stop()


def play(manifest: Manifest, *records: Record) -> None:
    with script(answer(start(3, manifest), *records)) as host:
        source = open_play(host.url)
        try:
            list(assembled(source))
        finally:
            source.close()


WINDOW = range(1 - SWIN_SIZE, 1)


def together() -> list[Record]:
    layers = range(LAYERS)
    return [SliceRecord(b, tuple(full_layer(b, n) for n in layers)) for b in WINDOW]


def one_by_one() -> list[Record]:
    records = [SliceRecord(birth, (full_layer(birth, 0),)) for birth in WINDOW]
    upper = [SliceRecord(0, (full_layer(0, n),), None, n) for n in range(1, LAYERS)]
    return [*records[:-1], *upper, records[-1]]


def huge_claims() -> list[Record]:
    packets = (full_layer(-3, 0, 1), *[claiming(SLICE_BYTES)] * (LAYERS - 1))
    return [SliceRecord(birth, packets) for birth in WINDOW]


@pytest.mark.parametrize("attack", [together, one_by_one, huge_claims])
def test_all_packets_of_a_slice_share_what_the_manifest_declares(attack: object) -> None:
    records = attack()  # type: ignore[operator]
    wire_bytes = len(answer(*records))
    assert wire_bytes < SLICE_BYTES / 2
    # A window of whole slices is what the manifest asks for; beside it one packet is inflated.
    limit_bytes = (SWIN_SIZE + 2) * SLICE_BYTES + 8 * wire_bytes + (2 << 20)
    assert limit_bytes < LAYERS * SLICE_BYTES
    with (
        at_most(limit_bytes),
        pytest.raises(CorruptError, match=r"S: layer . of the slice born at"),
    ):
        play(MANIFEST, *records)


def test_what_comes_again_counts_once_and_is_not_held() -> None:
    receiver = Receiver("S", MANIFEST, LAYERS, FrameRange())
    packet = full_layer(-3, 0)
    assert receiver.take(SliceRecord(-3, (packet,))) is not None
    with at_most(100_000):
        for _ in range(1000):
            assert receiver.take(SliceRecord(-3, (packet,))) is None
    both = receiver.take(SliceRecord(-3, (packet, packet)))
    assert both is not None
    assert both.first_layer == 1
    assert len(both.packets) == 1


def test_more_bytes_than_a_slice_can_have_are_not_held() -> None:
    manifest = small_manifest(40)
    receiver = Receiver("S", manifest, 3, FrameRange())
    with pytest.raises(CorruptError, match=r"-3: packet: 1000000 bytes; the manifest"):
        receiver.take(SliceRecord(-3, (bytes(1_000_000),)))
    with pytest.raises(CorruptError, match=r"^S: the slice born at -3 has 21000 bytes, but the"):
        receiver.take(SliceRecord(-3, (bytes(7_000),) * 3))


def test_a_record_that_no_slice_fills_is_not_waited_for() -> None:
    begun = answer(start()) + LENGTH.pack(60 << 20)
    with endless(begun, lambda n: bytes(1 << 16)) as url, at_most(6 << 20):
        source = open_play(url)
        with pytest.raises(CorruptError, match=r"a record of 62914560 bytes, at most 1\d{6}$"):
            list(source.packets())
        source.close()


def test_slices_that_nobody_asked_for_are_not_held() -> None:
    receiver = Receiver("S", small_manifest(40, live=True), 3, FrameRange())
    with at_most(100_000):
        for birth in range(100, 10_000):
            assert receiver.take(SliceRecord(birth, (b"zz",), None, 1)) is None
            assert receiver.take(SliceRecord(-birth, (b"zz",))) is None
    receiver = Receiver("S", small_manifest(40), 3, FrameRange(0, 3))
    with pytest.raises(
        CorruptError, match=r"^S: the slice born at 3 arrived, but the play ends before frame 3"
    ):
        receiver.take(SliceRecord(3, (b"zz",), None, 1))


def test_what_has_come_of_an_endless_stream_is_forgotten() -> None:
    receiver = Receiver("S", small_manifest(40, live=True), 3, FrameRange())
    with at_most(6 << 20):
        for birth in range(-3, 4 * KEPT_BIRTHS):
            assert receiver.take(SliceRecord(birth, (b"zz",))) is not None
    assert receiver.take(SliceRecord(0, (b"zz",), None, 1)) is None


def test_an_object_that_no_manifest_allows_is_not_fetched(tmp_path: Path) -> None:
    path = write_stream(tmp_path / "s", 13)
    records = StreamReader(path).records
    first = records[0]
    sizes = (1 << 30, *first.object_bytes[1:])
    false = type(first)(0, 0, first.num_frames, sizes, first.object_sha256, first.psnr_db)
    (path / "index.bin").write_bytes(pack_record(false) + pack_record(records[1]))
    with static_host(tmp_path) as host:
        for name in (f"{host}/s", str(path)):
            with (
                at_most(8 << 20),
                pytest.raises(CorruptError, match="segment 0 names an object of 1073741824 bytes"),
                opened(name) as source,
            ):
                list(source.packets())
