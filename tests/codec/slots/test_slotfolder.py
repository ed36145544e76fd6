"""Streams of version 2 on disk: any slice and window is what playing gives; writers may fail."""

from __future__ import annotations

import json
import os
import random
import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from codec.errors import CodecError, CorruptError, InvalidError
from codec.slice import Slice, window_births
from codec.slots.slotdecoder import SlotDecoder
from codec.slots.slotencoder import SlotEncoder
from codec.slots.slotlayout import SlotLayout
from codec.slots.update import Update
from codec.splats import Splats
from codec.stream import StreamReader, StreamWriter
from codec.stream.index import parse_index, record_bytes
from codec.stream.manifest import MASKS, Manifest, snapshot_part
from codec.stream.object import join_packets, object_packets
from codec.tools.audit import summarise, verify_stream
from tests.support.hostile import flips
from tests.support.slots.folder import put_part, slots_manifest, write_slots
from tests.support.slots.updates import patternless_updates, small_layout
from tests.support.tiny_stream import tiny_manifest, tiny_slice

NUM_FRAMES = 10


def same(a: Slice, b: Slice) -> bool:
    pairs = zip(a.splats.arrays, b.splats.arrays, strict=True)
    return (
        a.birth == b.birth
        and (a.start_offsets == b.start_offsets).all()
        and all(x.tobytes() == y.tobytes() for x, y in pairs)
    )


def files(path: Path) -> dict[str, bytes]:
    return {str(p.relative_to(path)): p.read_bytes() for p in path.rglob("*") if p.is_file()}


def played(updates: Sequence[Update], layout: SlotLayout, layers: int) -> dict[int, Slice]:
    """By birth the whole slices of a stream, without files."""
    encoder, decoder = SlotEncoder(layout), SlotDecoder(layout, layers)
    slices: dict[int, Slice] = {}
    for update in updates:
        encoded = encoder.append(update)
        if update.birth == 0:
            for chunk in encoder.snapshots()[:layers]:
                decoder.load(chunk.data)
            slices |= {b: decoder.whole(b) for b in window_births(0, layout.swin_size)}
        elif encoded is not None:
            changes = [change.data for change in encoded.changes[:layers]]
            decoder.apply(update.birth, encoded.mask.data, changes)
            slices[update.birth] = decoder.whole(update.birth)
    return slices


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("slots") / "whole"
    write_slots(path, NUM_FRAMES)
    return path


@pytest.fixture(scope="module")
def updates() -> list[Update]:
    return patternless_updates(slots_manifest().slot_layout, NUM_FRAMES)


@pytest.fixture
def stream(whole: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(whole, tmp_path / "stream"))


@given(
    swin_size=st.sampled_from([1, 2, 5]),
    segment_frames=st.sampled_from([1, 3, 8]),
    sh_degree=st.sampled_from([0, 1]),
    seed=st.integers(0, 1 << 32),
)
@settings(max_examples=12)
def test_any_slice_and_window_in_any_order(
    tmp_path_factory: pytest.TempPathFactory,
    swin_size: int,
    segment_frames: int,
    sh_degree: int,
    seed: int,
) -> None:
    path = tmp_path_factory.mktemp("order") / "s"
    layout = small_layout(swin_size, (5, 4, 3), sh_degree, segment_frames)
    updates = write_slots(path, 17, layout, seed % 1000)
    slices = {layers: played(updates, layout, layers) for layers in (1, 2, 3)}
    reader, rng = StreamReader(path), random.Random(seed)
    assert reader.births == range(1 - swin_size, 17)
    for _ in range(30):
        layers = rng.randrange(1, 4)
        if rng.random() < 0.5:
            birth = rng.choice(reader.births)
            assert same(reader.slice(birth, layers), slices[layers][birth])
            continue
        frame = rng.randrange(17)
        window = reader.window(frame, layers)
        assert [part.birth for part in window] == list(window_births(frame, swin_size))
        shown = [part.splats.take(np.flatnonzero(part.active(frame, swin_size))) for part in window]
        expected = [slices[layers][birth] for birth in window_births(frame, swin_size)]
        for found, part in zip(shown, expected, strict=True):
            wanted = part.splats.take(np.flatnonzero(part.active(frame, swin_size)))
            for a, b in zip(found.arrays, wanted.arrays, strict=True):
                assert a.tobytes() == b.tobytes()
        everything = Splats.concatenate(shown)
        assert len(reader.active_splats(frame, layers)) == len(everything)
    for layers in (1, 3):
        for part in reader.slices(1 - swin_size, layers):
            assert same(part, slices[layers][part.birth])
    assert verify_stream(path).num_frames == 17


def test_what_lies_in_the_folder(whole: Path) -> None:
    manifest = Manifest.from_json((whole / "manifest.json").read_bytes())
    assert (manifest.version, manifest.slots, manifest.layers) == (2, (9, 6), (0.6, 0.4))
    names = {"manifest.json", "index.bin"}
    parts = ("0", "1", "masks", "snapshot-0", "snapshot-1")
    names |= {f"segments/{segment}/{part}" for segment in range(3) for part in parts}
    assert set(files(whole)) == names
    assert record_bytes(2, True) == 20 + 44 * 2 + 40 * 3
    records = parse_index((whole / "index.bin").read_bytes(), 2, has_slots=True)
    assert [record.num_frames for record in records] == [4, 4, 2]
    for record in records:
        for part, size in zip(manifest.parts, record.part_bytes, strict=True):
            data = (whole / "segments" / str(record.segment) / str(part)).read_bytes()
            assert len(data) == size
            births = [birth for birth, _ in object_packets(data, 2)]
            first = record.first_frame
            # The slice born at 0 keeps all slots, which takes no packet.
            told = list(range(max(first, 1), first + record.num_frames))
            assert births == ([first] if str(part).startswith("snapshot") else told)


def test_a_reader_of_one_layer_needs_no_other(stream: Path) -> None:
    for path in stream.glob("segments/*/1"):
        path.write_bytes(b"lost")
    for path in stream.glob("segments/*/snapshot-1"):
        path.unlink()
    reader = StreamReader(stream)
    assert len(reader.window(9, 1)) == 3
    assert len(list(reader.slices(-2, 1))) == 12
    with pytest.raises(CodecError, match="snapshot-1 is missing"):
        reader.window(9, 2)


@pytest.mark.parametrize("kept", range(13))
def test_a_writer_that_was_stopped_goes_on_with_the_same_bytes(
    whole: Path, updates: list[Update], tmp_path: Path, kept: int
) -> None:
    path = tmp_path / "s"
    writer = StreamWriter.create(path, slots_manifest())
    for update in updates[:kept]:
        writer.append(update)
    durable = writer.durable_birth
    writer.abort()
    (path / "segments" / "7").mkdir()
    (path / "segments" / "7" / ".0.tmp").write_bytes(b"part")
    with open(path / "index.bin", "ab") as index:
        index.write(b"part")
    with StreamWriter.resume(path) as writer:
        assert writer.next_birth == durable
        for update in updates[writer.next_birth + 2 :]:
            writer.append(update)
        written = writer.bytes_written
    (path / "segments" / "7").rmdir()
    assert files(path) == files(whole)
    assert written == sum(sum(record.part_bytes) for record in StreamReader(path).records[:2])


def test_what_is_refused_or_fails_leaves_nothing(
    whole: Path, updates: list[Update], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "s"
    calls = 2

    def quality(birth: int, slices: Sequence[Slice]) -> list[float] | None:
        nonlocal calls
        calls += 1
        if calls % 4 == 0:
            raise ZeroDivisionError
        return [float(birth), 2.0 * birth] if birth >= 0 else None

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    failed = 0
    with StreamWriter.create(path, slots_manifest(), quality=quality) as writer:
        for update in updates:
            with pytest.raises(InvalidError, match="expected"):
                writer.append(replace(update, birth=update.birth + 1))
            with pytest.raises(InvalidError, match="at most 3"):
                writer.append(replace(update, statuses=update.statuses + 4))
            with pytest.raises(InvalidError, match="is for a stream of version 1"):
                writer.append(tiny_slice(update.birth))
            if update.birth in (3, 7):
                before = writer.next_birth
                with monkeypatch.context() as patch:
                    patch.setattr(os, "replace", full)
                    with pytest.raises((OSError, ZeroDivisionError)):
                        writer.append(update)
                assert writer.next_birth == before
            while True:
                try:
                    writer.append(update)
                    break
                except ZeroDivisionError:
                    failed += 1
    assert failed >= 3
    found, expected = files(path), files(whole)
    assert {n: d for n, d in found.items() if n != "index.bin"} == {
        n: d for n, d in expected.items() if n != "index.bin"
    }
    assert [record.psnr_db for record in StreamReader(path).records] == [
        (1.5, 3.0),
        (5.5, 11.0),
        (8.5, 17.0),
    ]


def test_quality_is_told_of_every_slice_once_and_whole(
    updates: list[Update], tmp_path: Path
) -> None:
    told: list[tuple[int, list[Slice]]] = []

    def quality(birth: int, slices: Sequence[Slice]) -> None:
        told.append((birth, list(slices)))

    path = tmp_path / "s"
    with StreamWriter.create(path, slots_manifest(), quality=quality) as writer:
        for update in updates[:9]:
            writer.append(update)
        writer.abort()
    with StreamWriter.resume(path, quality=quality) as writer:
        for update in updates[writer.next_birth + 2 :]:
            writer.append(update)
    births = [birth for birth, _ in told]
    assert births == [*range(-2, 7), *range(4, 10)]
    reader = StreamReader(path)
    for birth, slices in told:
        for layers, found in enumerate(slices, start=1):
            assert same(found, reader.slice(birth, layers))


def test_a_writer_that_is_closed_before_frame_0_has_written_nothing(
    updates: list[Update], tmp_path: Path
) -> None:
    with StreamWriter.create(tmp_path / "s", slots_manifest()) as writer:
        for update in updates[:2]:
            writer.append(update)
    reader = StreamReader(tmp_path / "s")
    assert (reader.num_frames, len(reader.births)) == (0, 0)
    with StreamWriter.create(tmp_path / "v1", tiny_manifest()) as writer:
        with pytest.raises(InvalidError, match="is for a stream of version 2"):
            writer.append(replace(updates[0]))
        for birth in range(-2, 1):
            writer.append(tiny_slice(birth))


def test_a_growing_stream_is_followed(updates: list[Update], tmp_path: Path) -> None:
    path = tmp_path / "s"
    writer = StreamWriter.create(path, slots_manifest())
    for update in updates[:6]:
        writer.append(update)
    reader = StreamReader(path)
    assert reader.num_frames == 4
    slices = reader.slices(-2, 2)
    early = [next(slices) for _ in range(6)]
    for update in updates[6:]:
        writer.append(update)
    writer.close()
    assert reader.refresh() == 2
    late = list(slices)
    assert [part.birth for part in early + late] == list(range(-2, 10))
    fresh = StreamReader(path)
    assert all(same(part, fresh.slice(part.birth, 2)) for part in early + late)


def test_any_altered_byte_is_found_in_its_file(stream: Path) -> None:
    rng = random.Random(2)
    names = sorted(str(p.relative_to(stream)) for p in stream.glob("segments/*/*"))
    for name in [*names, "index.bin"]:
        good = (stream / name).read_bytes()
        wrongs = list(flips(good))
        for wrong in rng.sample(wrongs, 12):
            (stream / name).write_bytes(wrong)
            with pytest.raises(CodecError) as caught:
                verify_stream(stream)
            assert str(caught.value).startswith(f"{stream / name}: ")
            if name != "index.bin":
                place = next(i for i, (a, b) in enumerate(zip(good, wrong, strict=True)) if a != b)
                assert caught.value.at is None or caught.value.at <= place
        (stream / name).write_bytes(good)
    assert verify_stream(stream).num_frames == NUM_FRAMES


def packets_of(stream: Path, segment: int, part: str) -> list[tuple[int, bytes]]:
    return object_packets((stream / "segments" / str(segment) / part).read_bytes(), 2)


def test_what_a_faulty_writer_would_do_is_named(stream: Path, tmp_path: Path) -> None:
    other = tmp_path / "other"
    write_slots(other, NUM_FRAMES, seed=1)
    cases = [
        (1, MASKS, "mask|change"),
        (1, "1", "change"),
        (1, snapshot_part(0), "is not what the slices before it left"),
        (0, snapshot_part(1), "change|snapshot"),
    ]
    for segment, part, message in cases:
        good = packets_of(stream, segment, part)
        put_part(stream, segment, part, packets_of(other, segment, part))
        with pytest.raises(CorruptError, match=message) as caught:
            verify_stream(stream)
        assert "segments" in str(caught.value)
        put_part(stream, segment, part, good)
    verify_stream(stream)
    masks = packets_of(stream, 0, MASKS)
    layer, one = packets_of(stream, 0, "0"), packets_of(stream, 0, "1")
    assert [birth for birth, _ in layer] == [1, 2, 3]
    put_part(stream, 0, "0", [(1, layer[1][1]), *layer[1:]])
    with pytest.raises(CorruptError, match="birth 2 where birth 1 belongs") as caught:
        StreamReader(stream).window(1, 2)
    assert str(caught.value).startswith(str(stream / "segments" / "0" / "0"))
    put_part(stream, 0, "0", layer)
    put_part(stream, 0, MASKS, [*masks, (4, masks[-1][1])])
    with pytest.raises(CorruptError, match=r"birth 4 is not one of 0\.\.3"):
        StreamReader(stream).window(1, 2)
    put_part(stream, 0, MASKS, masks)
    put_part(stream, 0, "1", packets_of(stream, 0, "1")[1:])
    with pytest.raises(CorruptError, match=r"segments/0/1: .*it is missing, but the mask declares"):
        StreamReader(stream).window(1, 2)
    put_part(stream, 0, "1", one)
    (stream / "segments" / "1" / "0").write_bytes(
        join_packets(packets_of(stream, 1, "0"), version=1)
    )
    with pytest.raises(CodecError):
        verify_stream(stream)


@pytest.mark.parametrize("part", [MASKS, "0", snapshot_part(0)])
def test_a_packet_that_was_altered_is_named_once(stream: Path, part: str) -> None:
    (birth, packet), *others = packets_of(stream, 0, part)
    put_part(stream, 0, part, [(birth, packet[:-1] + bytes([packet[-1] ^ 1])), *others])
    with pytest.raises(CorruptError, match="checksum") as caught:
        verify_stream(stream)
    assert str(caught.value).count("segments") == 1
    if part == snapshot_part(0):
        with pytest.raises(CorruptError, match="checksum") as caught:
            StreamReader(stream).window(0, 1)
        assert str(caught.value).count("segments") == 1


def test_summary(whole: Path) -> None:
    summary = summarise(whole)
    on_disk = sum(len(data) for data in files(whole).values())
    assert (summary.num_frames, summary.size_bytes, summary.profile) == (10, on_disk, "lattice")
    assert len(summary.layers) == 2


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"slots": (9, 7)}, "num_gs 45 is not swin_size 3 times 16"),
        ({"slots": (), "lattice": ()}, "0 layers of slots in version 2"),
        ({"slots": (15, 0)}, "at least 1"),
        ({"lattice": ()}, "0 lattices"),
        ({"version": 1}, "profile lattice in version 1"),
        ({"version": 3}, "version 3"),
        ({"profile": tiny_manifest().profile}, "profile compact in version 2"),
    ],
)
def test_manifests_that_are_refused(change: dict[str, object], message: str) -> None:
    with pytest.raises(InvalidError, match=message):
        replace(slots_manifest(), **change)  # type: ignore[arg-type]


def test_a_reader_takes_what_version_2_says_and_no_more() -> None:
    manifest = slots_manifest()
    value = json.loads(manifest.to_json())
    assert "layers" not in value
    assert Manifest.from_json(manifest.to_json()).slot_layout == manifest.slot_layout
    for change in (
        {"slots": [9, 6.0]},
        {"slots": [9, True, 5]},
        {"slots": 15},
        {"slots": None},
        {"lattice": [value["lattice"][0]]},
        {"lattice": [1, 2]},
        {"lattice": [{**value["lattice"][0], "colour": 9.9e-7}, value["lattice"][1]]},
        {"lattice": [{**value["lattice"][0], "colour": 1.1e6}, value["lattice"][1]]},
        {"lattice": [{**value["lattice"][0], "opacity_levels": 257}, value["lattice"][1]]},
        {"lattice": [{**value["lattice"][0], "log_scale_base": -1001}, value["lattice"][1]]},
        {"lattice": [{**value["lattice"][0], "log_scale_base": "0"}, value["lattice"][1]]},
        {"profile": "compact"},
        {"version": 1},
        {"segment_frames": 0},
    ):
        with pytest.raises(CodecError):
            Manifest.from_json(json.dumps({**value, **change}).encode())
    ignored = json.dumps({**value, "layers": "not in version 2"}).encode()
    assert Manifest.from_json(ignored).slots == (9, 6)
