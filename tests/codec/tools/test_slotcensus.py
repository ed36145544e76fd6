"""swings-stream info for a stream whose slots last: counts, bytes, and their plot."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from codec.coders.coder import compress
from codec.errors import CodecError
from codec.slots.update import Update
from codec.stream import StreamReader, StreamWriter
from codec.stream.manifest import MASKS, is_snapshot, snapshot_part
from codec.tools.audit import describe, summarise, verify_stream
from codec.tools.plot import JOIN_COLOUR, STATUS_COLOURS, draw_stream, played_bands, slot_bands
from codec.tools.slotcensus import count_slots
from tests.support.commands import run_ok
from tests.support.hostile import put_packets
from tests.support.slots.folder import slots_manifest, write_slots
from tests.support.slots.updates import Model, small_layout

LAYOUT = small_layout(3, (9, 6), 0, 4)
NUM_FRAMES = 10


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[Update]]:
    path = tmp_path_factory.mktemp("census") / "stream"
    return path, write_slots(path, NUM_FRAMES, LAYOUT)


@pytest.fixture
def stream(written: tuple[Path, list[Update]]) -> Path:
    return written[0]


@pytest.fixture
def updates(written: tuple[Path, list[Update]]) -> list[Update]:
    return written[1]


def size_of(stream: Path, pattern: str) -> int:
    return sum(path.stat().st_size for path in stream.glob(pattern))


def test_passing_slices_are_counted_in_their_layer(tmp_path: Path) -> None:
    layout = small_layout(1, (9, 6), 0, 4, 2)
    write_slots(tmp_path / "s", NUM_FRAMES, layout)
    census = count_slots(StreamReader(tmp_path / "s"))
    sums = census.statuses.sum(axis=2).tolist()
    assert sums == [[9, 6, 0], [9, 6, 15]] * (NUM_FRAMES // 2)
    kept = census.statuses[:, :, 0]
    assert (kept[1::2, :2] == [9, 6]).all()
    assert (kept[1::2, 2] < 15).any()
    assert (kept[2::2, :2].sum(axis=1) < 15).any()


def test_slots_are_counted_as_the_updates_say(stream: Path, updates: list[Update]) -> None:
    census = count_slots(StreamReader(stream))
    assert census.statuses[0].tolist() == [[9, 0, 0, 0], [6, 0, 0, 0]]
    for update in updates:
        if update.birth > 0:
            for layer, part in enumerate((update.statuses[:9], update.statuses[9:])):
                found = census.statuses[update.birth, layer].tolist()
                assert found == [int((part == status).sum()) for status in range(4)]
    model = Model(LAYOUT)
    for update in updates[:3]:
        model.take(update)
    held = [row < 9 for (_, row), slot in model.held.items() if slot is not None]
    assert census.first.tolist() == [held.count(True), held.count(False)]
    later = sum(int((u.statuses >= 2).sum()) for u in updates if u.birth > 0)
    assert census.brought.sum() == len(held) + later


def test_bytes_are_those_of_the_files(stream: Path) -> None:
    told = summarise(stream)
    assert told.slots is not None
    everything = size_of(stream, "**/*.*") + size_of(stream, "segments/*/*")
    assert told.size_bytes == everything
    joins = size_of(stream, "segments/[12]/snapshot-*")
    assert told.played_bytes == everything - joins
    assert sum(told.slots.join_snapshot_bytes) == joins
    assert told.slots.mask_bytes == size_of(stream, "segments/*/masks")
    for layer in range(2):
        assert told.slots.change_bytes[layer] == size_of(stream, f"segments/*/{layer}")
        first = size_of(stream, f"segments/0/snapshot-{layer}")
        assert told.slots.first_snapshot_bytes[layer] == first
    lower = size_of(stream, "segments/*/masks") + size_of(stream, "segments/*/0")
    assert told.layers[0].size_bytes == lower + size_of(stream, "segments/0/snapshot-0")
    overhead = size_of(stream, "*.*")
    assert told.layers[1].size_bytes == told.played_bytes - overhead
    brought = count_slots(StreamReader(stream)).brought.sum()
    assert told.bytes_per_gaussian == pytest.approx(told.layers[1].size_bytes / brought)
    means = [sum(mean) for mean in (told.slots.kept, told.slots.predicted, told.slots.new)]
    assert sum(means) + sum(told.slots.ended) == pytest.approx(15)


def test_people_and_programs_are_told_the_same(stream: Path) -> None:
    told = json.loads(run_ok("swings-stream", "info", stream, "--json"))
    assert told["slots"]["slots"] == [9, 6]
    text = run_ok("swings-stream", "info", stream)
    assert "45 active, in leases of 3 frames" in text
    joins = sum(told["slots"]["join_snapshot_bytes"])
    assert f"{told['played_bytes']} bytes, " in text
    assert f"; {joins} bytes of snapshots for joining players\n" in text
    assert f"slots        15 a slice; as a mean {sum(told['slots']['kept']):.1f} kept, " in text
    for layer in range(2):
        assert f"{told['slots']['change_bytes'][layer]} bytes; of {LAYOUT.slots[layer]}" in text


def test_a_stream_of_one_frame_and_one_without_any(tmp_path: Path) -> None:
    write_slots(tmp_path / "one", 1, small_layout(1, (4,), 1, 4))
    told = summarise(tmp_path / "one")
    assert "4 active, in leases of 1 frame\n" in describe(told)
    assert told.slots is not None
    assert (told.slots.kept, told.slots.join_snapshot_bytes) == ((0.0,), (0,))
    draw_stream(tmp_path / "one", tmp_path / "one.png")
    StreamWriter.create(tmp_path / "none", slots_manifest(LAYOUT)).abort()
    told = summarise(tmp_path / "none")
    assert (told.num_frames, told.bytes_per_gaussian) == (0, 0.0)
    assert "live, may still grow" in describe(told)


@pytest.mark.parametrize("name", ["1/masks", "0/snapshot-1"])
def test_what_is_altered_is_named(name: str, tmp_path: Path) -> None:
    write_slots(tmp_path / "s", NUM_FRAMES, LAYOUT)
    path = tmp_path / "s" / "segments" / name
    path.write_bytes(path.read_bytes()[:-1] + b"\0")
    with pytest.raises(CodecError, match=f"segments/{name}: "):
        summarise(tmp_path / "s")


@pytest.mark.parametrize("part", [MASKS, snapshot_part(0)])
def test_a_packet_beyond_its_slots_is_named_once(part: str, tmp_path: Path) -> None:
    write_slots(tmp_path / "s", 4, LAYOUT)
    births = range(1 if is_snapshot(part) else 4)
    packet = compress(bytes(9999), (0, 9999))
    put_packets(tmp_path / "s", 0, part, [(birth, packet) for birth in births])
    reads: list[Callable[[Path], object]] = [
        summarise,
        verify_stream,
        lambda path: StreamReader(path).window(3, 2),
    ]
    for read in reads:
        with pytest.raises(CodecError, match="9999 bytes of content, at most") as caught:
            read(tmp_path / "s")
        assert str(caught.value).count(f"segments/0/{part}: byte") == 1
        assert str(caught.value).count("(chunk of birth") == 1


def test_what_is_drawn(stream: Path, updates: list[Update], tmp_path: Path) -> None:
    reader = StreamReader(stream)
    bands = played_bands(reader)
    names = ["masks", "layer 0", "layer 1", "snapshots of frame 0"]
    assert [band.label for band in bands] == names
    seconds = [4 / 25, 4 / 25, 2 / 25]
    total = np.sum([band.values for band in bands], axis=0)
    for record, length, mbps in zip(reader.records, seconds, total, strict=True):
        assert mbps == pytest.approx(8e-6 * record.played_bytes / length)
    predicted = slot_bands(reader)[0].values
    for segment, births in enumerate(((1, 2, 3), (4, 5, 6, 7), (8, 9))):
        counts = [int((u.statuses == 2).sum()) for u in updates if u.birth in births]
        assert predicted[segment] == pytest.approx(sum(counts) / len(births))
    draw_stream(stream, tmp_path / "drawn.png")
    with Image.open(tmp_path / "drawn.png") as picture:
        drawn = np.asarray(picture.convert("RGB"))
    for colour in (*STATUS_COLOURS.values(), JOIN_COLOUR):
        rgb = [int(colour[i : i + 2], 16) for i in (1, 3, 5)]
        assert (drawn == rgb).all(axis=2).sum() > 20, colour
