"""swings-stream export --static of a stream whose slots last."""

from __future__ import annotations

from pathlib import Path

import pytest

from codec.coders.coder import Coder, coder_of, decompress
from codec.errors import CorruptError
from codec.slots.slotchange import encoded_elsewhere
from codec.slots.slotchunk import Kind
from codec.slots.slotencoder import SlotEncoder
from codec.slots.slotlayout import SlotLayout
from codec.stream import StreamReader, StreamWriter
from codec.stream.object import HEAD, object_packets
from codec.tools.audit import verify_stream
from codec.tools.static import export_static
from tests.goldens.slots_folder import StreamFolder
from tests.goldens.slots_reader import Reader
from tests.support.commands import run_ok
from tests.support.hostile import survives
from tests.support.slots.folder import slots_manifest, write_slots
from tests.support.slots.updates import patternless_updates, small_layout

LAYOUTS = [
    small_layout(3, (9, 6), 0, 4),
    small_layout(1, (4,), 2, 3),
    small_layout(2, (5, 4, 3), 1, 8),
]


@pytest.mark.parametrize("layout", LAYOUTS)
def test_every_chunk_is_that_of_the_original(tmp_path: Path, layout: SlotLayout) -> None:
    write_slots(tmp_path / "a", 11, layout)
    made = export_static(tmp_path / "a", tmp_path / "b")
    before, after = StreamReader(tmp_path / "a"), StreamReader(tmp_path / "b")
    assert after.manifest.to_json() == before.manifest.to_json()
    for record in before.records:
        for part in before.manifest.parts:
            old, new = (r.read_object(record.segment, part) for r in (before, after))
            assert HEAD.unpack_from(new.data)[3:5] == (2, Coder.GZIP)
            assert [e.birth for e in old.entries] == [e.birth for e in new.entries]
            for birth, packet in object_packets(new.data, 2):
                assert coder_of(packet) is Coder.GZIP
                assert new.content(birth) == old.content(birth)
    assert verify_stream(tmp_path / "b").num_frames == 11
    for name, told in (("a", made.source_bytes), ("b", made.size_bytes)):
        files = [path for path in (tmp_path / name).rglob("*") if path.is_file()]
        assert told == sum(path.stat().st_size for path in files)


def test_a_decoder_written_from_the_format_reads_it(tmp_path: Path) -> None:
    write_slots(tmp_path / "a", 10, LAYOUTS[0])
    export_static(tmp_path / "a", tmp_path / "b")
    held = []
    for name in ("a", "b"):
        folder = StreamFolder(tmp_path / name)
        reader = Reader(folder.shape)
        folder.load(reader, 0, (0, 1))
        folder.apply(reader, range(1, 10), (0, 1))
        held.append(reader.lanes)
    assert held[0] == held[1]


@pytest.mark.parametrize("layout", LAYOUTS)
def test_an_entropy_coder_is_told_the_same_edges_as_at_first(layout: SlotLayout) -> None:
    encoder = SlotEncoder(layout)
    for update in patternless_updates(layout, 13):
        encoded = encoder.append(update)
        if encoded is None:
            continue
        chunks = [(Kind.MASK, encoded.mask), *((Kind.CHANGE, one) for one in encoded.changes)]
        if update.birth % layout.segment_frames == 0:
            chunks += [(Kind.SNAPSHOT, chunk) for chunk in encoder.snapshots()]
        for kind, chunk in chunks:
            if not chunk.data:  # nothing changes, and there is no packet
                continue
            again = encoded_elsewhere(layout, kind, chunk.data)
            assert (again.birth, again.data) == (chunk.birth, chunk.data)
            assert list(again.edges) == list(chunk.edges)


def test_an_export_exports_again_and_a_live_stream_as_far_as_it_has_come(tmp_path: Path) -> None:
    manifest = slots_manifest(LAYOUTS[0])
    writer = StreamWriter.create(tmp_path / "a", manifest)
    for update in patternless_updates(LAYOUTS[0], 6):
        writer.append(update)
    writer.abort()
    export_static(tmp_path / "a", tmp_path / "b")
    after = StreamReader(tmp_path / "b")
    assert (after.num_frames, after.manifest.live) == (4, False)
    export_static(tmp_path / "b", tmp_path / "c")
    for path in (tmp_path / "b").rglob("*"):
        if path.is_file():
            assert (tmp_path / "c" / path.relative_to(tmp_path / "b")).read_bytes() == (
                path.read_bytes()
            )


def test_a_wrong_chunk_is_named_and_nothing_is_left(tmp_path: Path) -> None:
    write_slots(tmp_path / "a", 10, LAYOUTS[0])
    path = tmp_path / "a" / "segments" / "1" / "snapshot-1"
    path.write_bytes(path.read_bytes()[:-1] + b"\0")
    with pytest.raises(CorruptError, match="segments/1/snapshot-1"):
        export_static(tmp_path / "a", tmp_path / "b")
    assert [entry.name for entry in tmp_path.iterdir()] == ["a"]


def test_a_packet_of_gzip_cannot_hold_more_than_its_slots_fill(tmp_path: Path) -> None:
    write_slots(tmp_path / "a", 4, LAYOUTS[0])
    export_static(tmp_path / "a", tmp_path / "b")
    data = (tmp_path / "b" / "segments" / "0" / "masks").read_bytes()
    [_, (_, packet), *_] = object_packets(data, 2)
    most = LAYOUTS[0].max_mask_bytes
    assert survives(lambda food: decompress(food, most), packet)
    assert not survives(lambda food: decompress(food, 15), packet)


def test_the_command(tmp_path: Path) -> None:
    write_slots(tmp_path / "a", 10, LAYOUTS[0])
    told = run_ok("swings-stream", "export", tmp_path / "a", tmp_path / "b", "--static")
    assert told.startswith(f"{tmp_path}/b: 10 frames in 3 segments for any web server, ")
    told = run_ok("swings-stream", "verify", tmp_path / "b")
    assert told == f"{tmp_path}/b: 10 frames in 3 segments are intact\n"
