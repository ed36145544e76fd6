"""Kept Gaussians of a stream: the highest ranks of every slice, for their whole life."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from codec.splats import Splats
from codec.stream import StreamReader
from tests.support.drawn import same_splats
from tests.support.hosted_streams import write_stream
from tests.support.slots.folder import write_slots
from tests.support.slots.updates import small_layout
from trainer.score.dropped import NOBODY, Drop, lives_of, opacities, places, write_kept

FRAMES = 9
SHARES = (1.0, 0.5, 0.2)


@pytest.mark.parametrize("whole", [False, True])
@pytest.mark.parametrize("swin_size", [1, 3])
def test_the_files_show_what_is_kept_alone(whole: bool, swin_size: int, tmp_path: Path) -> None:
    if whole:
        reader = StreamReader(write_stream(tmp_path / "stream", FRAMES, swin_size=swin_size))
    else:
        write_slots(tmp_path / "stream", FRAMES, small_layout(swin_size, (20, 10), 0, 4))
        reader = StreamReader(tmp_path / "stream")
    lives = lives_of(reader)
    worth = opacities(reader, lives)
    ranks = places(worth)
    drops, layers = [Drop(share, ranks) for share in SHARES], reader.manifest.num_layers
    paths = write_kept(reader, lives, drops, tmp_path / "kept")
    for drop, path in zip(drops, paths, strict=True):
        again = StreamReader(path)
        assert again.manifest_json == reader.manifest_json
        assert again.num_frames == reader.num_frames
        for of_slice in lives.values():
            held, kept = of_slice != NOBODY, drop.kept(of_slice)
            assert kept.sum() == (kept & held).sum() == round(drop.share * held.sum())
            left_out = worth[of_slice[held & ~kept]].max(initial=0)
            assert worth[of_slice[kept]].min(initial=1) >= left_out
        for frame in range(FRAMES):
            parts = []
            for part in reader.window(frame, layers):
                rows = part.active(frame, swin_size) & drop.kept(lives[part.birth])
                parts.append(part.splats.take(np.flatnonzero(rows)))
            found = again.active_splats(frame, layers)
            assert same_splats(found, Splats.concatenate(parts))
            if drop.share == 1:
                assert same_splats(found, reader.active_splats(frame, layers))
