"""Kept Gaussians of a stream: the highest ranks of every slice, for their whole life."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from codec.splats import Splats
from codec.stream import StreamReader
from tests.support.drawn import same_splats
from tests.support.hosted_streams import write_stream
from tests.support.slots.folder import write_slots
from tests.support.slots.updates import small_layout
from trainer.score.dropped import NOBODY, Drop, lives_of, opacities, places, write_kept

FRAMES = 9
SHARES = (1.0, 0.5, 0.2)


@given(
    st.lists(st.sampled_from([0.0, 0.25, 0.5, 1.0]), min_size=1, max_size=40),
    st.lists(st.floats(0.01, 1), min_size=2, max_size=2),
    st.data(),
)
def test_high_ranks_are_kept(values: list[float], shares: list[float], data: st.DataObject) -> None:
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


@pytest.mark.parametrize("whole", [False, True])
@pytest.mark.parametrize("swin_size", [1, 3])
def test_the_files_show_what_is_kept_alone(whole: bool, swin_size: int, tmp_path: Path) -> None:
    if whole:
        reader = StreamReader(write_stream(tmp_path / "stream", FRAMES, swin_size=swin_size))
    else:
        write_slots(tmp_path / "stream", FRAMES, small_layout(swin_size, (20, 10), 0, 4))
        reader = StreamReader(tmp_path / "stream")
    lives = lives_of(reader)
    ranks = places(opacities(reader, lives))
    drops, layers = [Drop(share, ranks) for share in SHARES], reader.manifest.num_layers
    paths = write_kept(reader, lives, drops, tmp_path / "kept")
    for drop, path in zip(drops, paths, strict=True):
        again = StreamReader(path)
        assert again.manifest_json == reader.manifest_json
        assert again.num_frames == reader.num_frames
        for frame in range(FRAMES):
            parts = []
            for part in reader.window(frame, layers):
                rows = part.active(frame, swin_size) & drop.kept(lives[part.birth])
                parts.append(part.splats.take(np.flatnonzero(rows)))
            found = again.active_splats(frame, layers)
            assert same_splats(found, Splats.concatenate(parts))
            if drop.share == 1:
                assert same_splats(found, reader.active_splats(frame, layers))
