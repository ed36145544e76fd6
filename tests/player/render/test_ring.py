"""The ring of lanes against the stream reader's own idea of a frame."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from codec.errors import InvalidError
from codec.splats import Splats
from codec.stream import StreamReader
from player.render.ring import Ring
from tests.support.hosted_streams import SLICE_SIZE, SWIN_SIZE, random_slice, write_stream


def same(a: Splats, b: Splats) -> bool:
    return all(
        np.array_equal(getattr(a, name), getattr(b, name))
        for name in ("means", "log_scales", "quats", "logit_opacities", "sh")
    )


@pytest.mark.parametrize("num_layers", [1, 2, 3])
def test_every_frame_is_what_the_reader_says(tmp_path: Path, num_layers: int) -> None:
    reader = StreamReader(write_stream(tmp_path / "s", 13))
    ring = Ring(SWIN_SIZE, SLICE_SIZE, 1)
    for birth in range(1 - SWIN_SIZE, 13):
        ring.put(reader.slice(birth, num_layers))
        if birth >= 0:
            assert same(ring.active(birth), reader.active_splats(birth, num_layers))


def test_a_shorter_slice_leaves_nothing_of_the_longer_one_before() -> None:
    ring = Ring(2, 5, 0)
    ring.put(random_slice(0, 5, 0))
    ring.put(random_slice(1, 5, 0))
    ring.put(random_slice(2, 2, 0))
    births = [s.splats.take(np.flatnonzero(s.active(3, 2))) for s in (random_slice(2, 2, 0),)]
    assert same(ring.active(3), births[0])


def test_lanes_of_other_windows_do_not_show() -> None:
    ring = Ring(3, 4, 0)
    assert len(ring.active(0)) == 0
    ring.put(random_slice(0, 4, 0))
    assert len(ring.active(2)) == 4
    assert len(ring.active(3)) == 0


def test_what_does_not_fit_is_refused() -> None:
    ring = Ring(2, 3, 0)
    with pytest.raises(InvalidError, match="4 Gaussians"):
        ring.put(random_slice(0, 4, 0))
    with pytest.raises(InvalidError, match="SH degree 1"):
        ring.put(random_slice(0, 3, 1))
    with pytest.raises(InvalidError, match="at least one lane"):
        Ring(0, 3, 0)
