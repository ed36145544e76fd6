"""The plain reader of version 2: who joins, who plays, and who lacks something."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.goldens.slots_cases import SHAPES, assert_same, make_shape, seen
from tests.goldens.slots_decoder import ENDED, NEW, PREDICTED, Gaussian, Hole, Shape
from tests.goldens.slots_encoder import RandomStream, encode_snapshot
from tests.goldens.slots_folder import (
    Lanes,
    StreamFolder,
    state_at,
    state_played,
    without_passed_starts,
)
from tests.goldens.slots_reader import Reader


@pytest.mark.parametrize("coder", [1, 2])
@pytest.mark.parametrize("shape", SHAPES)
def test_who_joins_and_who_plays_have_what_was_written(
    tmp_path: Path, shape: Shape, coder: int
) -> None:
    stream = RandomStream(shape, 17, 1)
    stream.write(tmp_path / "s", coder)
    for frame, truth in enumerate(stream.truth):
        assert_same(state_at(tmp_path / "s", frame, len(shape.slots)), truth, frame)
    assert_same(state_played(tmp_path / "s", 16, len(shape.slots)), stream.truth[16], 16)


def test_layers_that_are_not_loaded_are_unknown_until_ended(tmp_path: Path) -> None:
    stream = RandomStream(make_shape(), 14, 2)
    stream.write(tmp_path / "s")
    for lane, true_lane in zip(state_at(tmp_path / "s", 13, 1), stream.truth[13], strict=True):
        assert list(map(seen, lane[0])) != []
        assert all(slot in (Hole.UNKNOWN, Hole.EMPTY) for slot in lane[1])
        holes = [i for i, slot in enumerate(lane[1]) if slot is Hole.EMPTY]
        assert all(true_lane[1][i] is Hole.EMPTY for i in holes)


def loaded(
    folder: Path, last: int, missing: set[tuple[int, int]], missing_masks: tuple[int, ...] = ()
) -> Reader:
    stream = StreamFolder(folder)
    reader = Reader(stream.shape)
    stream.load(reader, 0, (0, 1))
    stream.apply(reader, range(1, last + 1), (0, 1), missing, missing_masks)
    return reader


Known = dict[tuple[int, int, int], bool]


def follow(known: Known, stream: RandomStream, frame: int, lost: set[tuple[int, int]]) -> None:
    """Notes of each (lane, layer, slot) of the slice whether a reader knows what it holds."""
    for layer in (0, 1):
        for i, status in enumerate(stream.masks[frame][layer]):
            place = (frame % 3, layer, i)
            if status in (ENDED, NEW):
                known[place] = True
            if (frame, layer) in lost and status in (PREDICTED, NEW):
                known[place] = False


def assert_known(lanes: Lanes, known: Known, stream: RandomStream, frame: int) -> None:
    found, truth = (without_passed_starts(s, frame) for s in (lanes, stream.truth[frame]))
    for lane in range(3):
        for layer in (0, 1):
            for i, slot in enumerate(found[lane][layer]):
                if known.get((lane, layer, i), True):
                    assert seen(slot) == seen(truth[lane][layer][i])
                else:
                    assert slot is Hole.UNKNOWN


def test_a_packet_that_is_missing_costs_what_it_would_have_changed(tmp_path: Path) -> None:
    stream = RandomStream(make_shape(), 21, 3)
    stream.write(tmp_path / "s")
    known: Known = {}
    lost = {(4, 0), (4, 1), (6, 0), (7, 1)}
    for frame in range(1, 21):
        follow(known, stream, frame, lost)
        assert_known(loaded(tmp_path / "s", frame, lost).lanes, known, stream, frame)


@pytest.mark.parametrize(
    ("lost", "unread"),
    [(4, {4, 7, 10, 13}), (13, {13}), (14, {14}), (17, {17, 20, 23, 26})],
)
def test_a_mask_that_is_missing_costs_its_lane(tmp_path: Path, lost: int, unread: set[int]) -> None:
    """Later masks hang on it in its segment of 14 frames, but for that of the first frame."""
    stream = RandomStream(make_shape(segment_frames=14), 30, 8)
    stream.write(tmp_path / "s")
    known: Known = {}
    for frame in range(1, 30):
        follow(known, stream, frame, set())
        if frame in unread:
            for layer, count in enumerate((9, 5)):
                known.update({(frame % 3, layer, i): False for i in range(count)})
        reader = loaded(tmp_path / "s", frame, set(), (lost,))
        assert_known(reader.lanes, known, stream, frame)
        if frame in unread and frame % 14 == 0:
            folder = StreamFolder(tmp_path / "s")
            folder.load(reader, frame // 14, (0, 1))
            assert_same(reader.lanes, stream.truth[frame], frame)


def test_a_mask_may_come_late(tmp_path: Path) -> None:
    stream = RandomStream(make_shape(segment_frames=14), 14, 9)
    stream.write(tmp_path / "s")
    reader = loaded(tmp_path / "s", 13, {(7, 1)}, (4, 5))
    for birth in (5, 4):
        reader.late_mask(birth, stream.mask_chunks[birth])
    reader.late(7, 1, stream.changes[7][1])
    assert_same(reader.lanes, stream.truth[13], 13)


def test_nothing_of_a_corrupt_chunk_is_applied(tmp_path: Path) -> None:
    """It counts as missing, and the right one may still come."""
    stream = RandomStream(make_shape(), 12, 10)
    stream.write(tmp_path / "s")
    lost, lost_masks = {(2, 0), (4, 1), (8, 0), (10, 1)}, (3, 8)
    reader = loaded(tmp_path / "s", 0, set())
    for birth in range(1, 12):
        mask = stream.mask_chunks[birth]
        changes = dict(enumerate(stream.changes[birth]))
        changes.update({at: changes[at][:-1] for at in changes if (birth, at) in lost})
        reader.apply(birth, mask + b"\0" if birth in lost_masks else mask, changes)
        assert reader.lanes == loaded(tmp_path / "s", birth, lost, lost_masks).lanes
    for layer in (0, 1):
        snapshot = encode_snapshot(stream.truth[7], 7, layer, stream.shape)
        before = [list(lane) for lane in reader.lanes]
        reader.load(snapshot[:-1])
        assert reader.lanes == before
    for birth in lost_masks:
        reader.late_mask(birth, stream.mask_chunks[birth])
    for birth, layer in lost:
        reader.late(birth, layer, stream.changes[birth][layer])
    assert_same(reader.lanes, stream.truth[11], 11)


def test_a_predicted_gaussian_shows_from_the_birth(tmp_path: Path) -> None:
    stream = RandomStream(make_shape(), 20, 11)
    stream.write(tmp_path / "s")
    count = 0
    for frame in range(1, 20):
        lane = loaded(tmp_path / "s", frame, set()).lanes[frame % 3]
        for slots, statuses in zip(lane, stream.masks[frame], strict=True):
            for slot, status in zip(slots, statuses, strict=True):
                if status == PREDICTED:
                    assert isinstance(slot, Gaussian)
                    assert slot.start == frame
                    count += 1
    assert count > 20


def test_packets_may_come_late_in_any_order(tmp_path: Path) -> None:
    stream = RandomStream(make_shape(), 21, 4)
    stream.write(tmp_path / "s")
    missing = {(4, 0), (4, 1), (7, 0), (10, 0), (12, 1)}
    reader = loaded(tmp_path / "s", 12, missing)
    assert any(Hole.UNKNOWN in slots for lane in reader.lanes for slots in lane)
    for birth, layer in sorted(missing, reverse=True):
        reader.late(birth, layer, stream.changes[birth][layer])
    assert_same(reader.lanes, stream.truth[12], 12)


def test_a_snapshot_takes_a_layer_up_again(tmp_path: Path) -> None:
    stream = RandomStream(make_shape(), 12, 5)
    stream.write(tmp_path / "s")
    folder = StreamFolder(tmp_path / "s")
    reader = loaded(tmp_path / "s", 7, {(4, 1), (5, 1), (6, 1)})
    folder.load(reader, 1, [1])
    reader.late(4, 1, stream.changes[4][1])
    folder.apply(reader, range(8, 12), (0, 1))
    assert_same(reader.lanes, stream.truth[11], 11)
