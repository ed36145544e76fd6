"""Kept Gaussians of a stream: the highest ranks of every slice, for their whole life."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from codec.slice import HIDDEN
from codec.slots.update import ENDED, KEPT, NEW, PREDICTED, Update
from codec.splats import Splats
from codec.stream import StreamReader
from tests.support.drawn import same_splats
from tests.support.hosted_streams import write_stream
from tests.support.slots.folder import write_slots
from tests.support.slots.slot_streams import write_busy_stream
from tests.support.slots.updates import small_layout
from trainer.run.rank import slices_by_contribution
from trainer.score.dropped import (
    NOBODY,
    Drop,
    Ints,
    contributions,
    lives_of,
    opacities,
    places,
    statuses_of_kept,
    write_kept,
)
from trainer.step.raster import View

FRAMES = 9
SHARES = (1.0, 0.5, 0.2)


def views_of(reader: StreamReader) -> list[View]:
    manifest = reader.manifest
    return [View.prepare(camera, manifest.near_m) for camera in manifest.cameras]


def slots_of(path: Path, swin_size: int) -> tuple[StreamReader, list[Update]]:
    """A stream with all possible changes of slots, and its updates."""
    updates = write_slots(path, FRAMES, small_layout(swin_size, (20, 10), 0, 4))
    return StreamReader(path), updates


@pytest.mark.parametrize("swin_size", [1, 3])
def test_a_life_lasts_until_its_slot_is_ended_or_new(swin_size: int, tmp_path: Path) -> None:
    reader, updates = slots_of(tmp_path, swin_size)
    lives = lives_of(reader)
    assert list(lives) == list(reader.births)
    begun = [of_slice[of_slice != NOBODY] for birth, of_slice in lives.items() if birth <= 0]
    seen = set(np.concatenate(begun).tolist())
    assert len(seen) == sum(map(len, begun))
    for update in updates[swin_size:]:
        before, after = lives[update.birth - swin_size], lives[update.birth]
        goes_on = (update.statuses == KEPT) | (update.statuses == PREDICTED)
        assert (after[goes_on] == before[goes_on]).all()
        assert (after[update.statuses == ENDED] == NOBODY).all()
        fresh = set(after[update.statuses == NEW].tolist())
        assert len(fresh) == (update.statuses == NEW).sum()
        assert not fresh & seen
        seen |= fresh
    assert seen == set(range(len(seen)))


@given(
    st.lists(st.sampled_from([0.0, 0.25, 0.5, 1.0]), min_size=1, max_size=40),
    st.lists(st.floats(0.01, 1), min_size=2, max_size=2),
    st.data(),
)
def test_the_highest_ranks_are_kept(
    values: list[float], shares: list[float], data: st.DataObject
) -> None:
    importances = np.array(values)
    order = data.draw(st.permutations(range(len(values))))
    empty = data.draw(st.lists(st.booleans(), min_size=len(values), max_size=len(values)))
    of_slice = np.where(empty, NOBODY, np.array(order))
    ranks = places(importances)
    assert sorted(ranks) == list(range(len(values)))
    few, many = (Drop(share, ranks).kept(of_slice) for share in sorted(shares))
    held = of_slice != NOBODY
    for share, kept in zip(sorted(shares), (few, many), strict=True):
        assert kept.sum() == round(share * held.sum())
        assert not kept[~held].any()
        if kept.any() and (held & ~kept).any():
            left_out = importances[of_slice[held & ~kept]]
            assert importances[of_slice[kept]].min() >= left_out.max()
    assert not (few & ~many).any()


def test_what_comes_back_is_new_and_what_goes_is_ended() -> None:
    statuses = np.repeat(np.array([KEPT, ENDED, PREDICTED, NEW], np.uint8), 4)
    before, kept = np.tile([False, False, True, True], 4), np.tile([False, True, False, True], 4)
    possible = ~((statuses == ENDED) & kept)
    expected = [
        *(KEPT, NEW, ENDED, KEPT),
        *(KEPT, NEW, ENDED, ENDED),
        *(KEPT, NEW, ENDED, PREDICTED),
        *(KEPT, NEW, ENDED, NEW),
    ]
    found = statuses_of_kept(statuses, before, kept)
    assert found.dtype == np.uint8
    assert (found == expected)[possible].all()


def shown(reader: StreamReader, lives: Mapping[int, Ints], frame: int, drop: Drop) -> Splats:
    """The kept ones of the Gaussians that show at `frame`."""
    manifest, parts = reader.manifest, []
    for part in reader.window(frame, manifest.num_layers):
        rows = part.active(frame, manifest.swin_size) & drop.kept(lives[part.birth])
        parts.append(part.splats.take(np.flatnonzero(rows)))
    return Splats.concatenate(parts)


@pytest.mark.parametrize("whole", [False, True])
@pytest.mark.parametrize("swin_size", [1, 3])
def test_the_files_show_what_is_kept_and_nothing_else(
    whole: bool, swin_size: int, tmp_path: Path
) -> None:
    if whole:
        reader = StreamReader(write_stream(tmp_path / "stream", FRAMES, swin_size=swin_size))
    else:
        reader, _ = slots_of(tmp_path / "stream", swin_size)
    lives = lives_of(reader)
    ranks = places(opacities(reader, lives))
    drops = [Drop(share, ranks) for share in SHARES]
    paths = write_kept(reader, lives, drops, tmp_path / "kept")
    for drop, path in zip(drops, paths, strict=True):
        again = StreamReader(path)
        assert again.manifest_json == reader.manifest_json
        assert again.num_frames == reader.num_frames
        layers = reader.manifest.num_layers
        for frame in range(FRAMES):
            found = again.active_splats(frame, layers)
            assert same_splats(found, shown(reader, lives, frame, drop))
            if drop.share == 1:
                assert same_splats(found, reader.active_splats(frame, layers))


def test_all_of_a_stream_is_written_byte_for_byte(tmp_path: Path) -> None:
    layout = small_layout(2, (40, 20), 0, 4)
    reader = StreamReader(write_busy_stream(tmp_path / "stream", FRAMES, layout))
    lives = lives_of(reader)
    drop = Drop(1.0, places(opacities(reader, lives)))
    (path,) = write_kept(reader, lives, [drop], tmp_path / "kept")
    assert StreamReader(path).records[0].part_sha256 == reader.records[0].part_sha256
    sizes = [record.part_bytes for record in StreamReader(path).records]
    assert sizes == [record.part_bytes for record in reader.records]


def test_by_opacity_the_most_opaque_of_every_slice_are_kept(tmp_path: Path) -> None:
    reader = StreamReader(write_stream(tmp_path / "stream", FRAMES))
    lives = lives_of(reader)
    drop = Drop(0.3, places(opacities(reader, lives)))
    (path,) = write_kept(reader, lives, [drop], tmp_path / "kept")
    again, layers = StreamReader(path), reader.manifest.num_layers
    for birth in reader.births:
        logits = np.sort(reader.slice(birth, layers).splats.logit_opacities)
        part = again.slice(birth, layers)
        kept = np.sort(part.splats.logit_opacities[part.start_offsets != HIDDEN])
        assert (kept == logits[len(logits) - round(0.3 * len(logits)) :]).all()


def test_contributions_are_those_that_the_trainer_ranks_by(tmp_path: Path) -> None:
    # Equal ranks do not follow the order in the files.
    kept = Drop(0.5, places(np.ones(1000))).kept(np.arange(1000))
    assert 200 < kept[:500].sum() < 300
    reader = StreamReader(write_stream(tmp_path / "stream", FRAMES))
    views, lives = views_of(reader), lives_of(reader)
    found = contributions(reader, lives, views, len(views))
    for part in slices_by_contribution(reader, views):
        order = np.argsort(-found[lives[part.birth]], kind="stable")
        splats = reader.slice(part.birth, reader.manifest.num_layers).splats
        assert same_splats(splats.take(order), part.splats)


def test_cameras_take_turns(tmp_path: Path) -> None:
    # For a slice that lives for one frame, the result shows which camera saw it.
    path = write_stream(tmp_path / "stream", 5, swin_size=1)
    reader = StreamReader(path)
    views, lives = views_of(reader)[:3], lives_of(reader)
    in_turn = contributions(reader, lives, views, 1)
    alone = [contributions(reader, lives, [view], 1) for view in views]
    assert not np.array_equal(alone[0], alone[1])
    for birth, of_slice in lives.items():
        assert (in_turn[of_slice] == alone[birth % 3][of_slice]).all()
