"""swings-stream info: counts and bytes of slots, and their plot."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from codec.errors import CodecError, CorruptError, InvalidError
from codec.slots.slotlayout import Update
from codec.stream import StreamReader, StreamWriter
from codec.tools.audit import count_slots, describe, summarise
from codec.tools.plot import JOIN_COLOUR, STATUS_COLOURS, draw_stream, played_bands, slot_bands
from tests.support.commands import run, run_ok
from tests.support.hostile import refused
from tests.support.slots.folder import slots_manifest, write_slots
from tests.support.slots.updates import Model, small_layout
from tests.support.tiny_stream import append_tiny, tiny_manifest, write_tiny

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
    joins = size_of(stream, "segments/[12]/keyframe-*")
    assert told.played_bytes == everything - joins
    assert sum(told.slots.join_keyframe_bytes) == joins
    assert told.slots.skip_map_bytes == size_of(stream, "segments/*/skipmaps")
    for layer in range(2):
        assert told.slots.change_bytes[layer] == size_of(stream, f"segments/*/{layer}")
        first = size_of(stream, f"segments/0/keyframe-{layer}")
        assert told.slots.first_keyframe_bytes[layer] == first
    lower = size_of(stream, "segments/*/skipmaps") + size_of(stream, "segments/*/0")
    assert told.layers[0].size_bytes == lower + size_of(stream, "segments/0/keyframe-0")
    overhead = size_of(stream, "*.*")
    assert told.layers[1].size_bytes == told.played_bytes - overhead
    brought = count_slots(StreamReader(stream)).brought.sum()
    assert told.bytes_per_gaussian == pytest.approx(told.layers[1].size_bytes / brought)
    means = [sum(mean) for mean in (told.slots.kept, told.slots.predicted, told.slots.new)]
    assert sum(means) + sum(told.slots.ended) == pytest.approx(15)


def test_a_stream_of_one_frame_and_one_without_any(tmp_path: Path) -> None:
    write_slots(tmp_path / "one", 1, small_layout(1, (4,), 1, 4))
    told = summarise(tmp_path / "one")
    count = len(StreamReader(tmp_path / "one").active_splats(0, 1))
    said = f"{count} in frame 0, in 4 slots with leases of 1 frame\nbounds       x -"
    assert said in describe(told)
    assert told.slots is not None
    assert (told.slots.kept, told.slots.join_keyframe_bytes) == ((0.0,), (0,))
    draw_stream(tmp_path / "one", tmp_path / "one.png")
    StreamWriter.create(tmp_path / "none", slots_manifest(LAYOUT)).abort()
    told = summarise(tmp_path / "none")
    assert (told.num_frames, told.bytes_per_gaussian) == (0, 0.0)
    assert "live, may still grow" in describe(told)


@pytest.mark.parametrize("name", ["1/skipmaps", "0/keyframe-1"])
def test_what_is_altered_is_named(name: str, tmp_path: Path) -> None:
    write_slots(tmp_path / "s", NUM_FRAMES, LAYOUT)
    path = tmp_path / "s" / "segments" / name
    path.write_bytes(path.read_bytes()[:-1] + b"\0")
    refused(CodecError, f"segments/{name}: ", summarise, tmp_path / "s")


def test_what_is_drawn(stream: Path, updates: list[Update], tmp_path: Path) -> None:
    reader = StreamReader(stream)
    bands = played_bands(reader)
    names = ["skipmaps", "layer 0", "layer 1", "keyframes of frame 0"]
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


@pytest.fixture(scope="module")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A stream of six frames in two segments of unknown quality."""
    path = tmp_path_factory.mktemp("plot") / "stream"
    write_tiny(path, 6)
    return path


def test_quality_is_drawn_where_it_is_known(tiny: Path, tmp_path: Path) -> None:
    """Of any number of layers, with any title."""
    manifest, title = tiny_manifest(), "$\\frac{1}$ _a_ \n" * 20
    slots, lattices = (40,) * 16, manifest.lattice[:1] * 16
    made = replace(manifest, slots=slots, lattice=lattices, title=title)
    with StreamWriter.create(
        tmp_path / "scored", made, quality=lambda frame, slices: (20.0,) * 16
    ) as writer:
        append_tiny(writer, 6)
    heights_px = []
    for stream in (tiny, tmp_path / "scored"):
        draw_stream(stream, tmp_path / "deep" / "drawn.png")
        with Image.open(tmp_path / "deep" / "drawn.png") as picture:
            heights_px.append(picture.height)
    assert heights_px[1] > 1.3 * heights_px[0]
    assert [path.name for path in (tmp_path / "deep").iterdir()] == ["drawn.png"]


def test_nothing_to_draw_and_nothing_half_drawn(tmp_path: Path) -> None:
    StreamWriter.create(tmp_path / "empty", tiny_manifest()).abort()
    with pytest.raises(InvalidError, match="has no frames yet; there is nothing to draw"):
        draw_stream(tmp_path / "empty", tmp_path / "drawn.png")
    refused(CorruptError, "is not a folder", draw_stream, tmp_path / "none", tmp_path / "drawn.png")
    assert [path.name for path in tmp_path.iterdir()] == ["empty"]


def test_the_command(tiny: Path, tmp_path: Path) -> None:
    picture = tmp_path / "rate.png"
    told = json.loads(run_ok("swings-stream", "info", tiny, "--json", "--plot", picture))
    drawn = picture.read_bytes()
    assert told["num_frames"] == 6
    text = run_ok("swings-stream", "info", tiny, "--plot", picture)
    assert text.endswith(f"picture      {picture}\n")
    assert "6 frames, 0.2 s at 25 fps" in text
    assert "slots        40 a slice; as a mean 0.0 kept, " in text
    assert picture.read_bytes() == drawn
    done = run("swings-stream", "info", tiny, "--plot", tiny / "index.bin" / "x.png")
    assert (done.returncode, done.stderr.count("\n")) == (1, 1)
    assert done.stderr.startswith("swings-stream: ")
