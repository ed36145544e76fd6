"""The ring of lanes, compared with the frames of the stream reader."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given

from codec.errors import InvalidError
from codec.slice import Slice
from codec.splats import Splats
from codec.stream import StreamReader
from player.render.cpu import CpuRenderer, Ring, render_splats
from tests.support.drawn import same_splats
from tests.support.hosted_streams import (
    SLICE_SIZE,
    SWIN_SIZE,
    random_slice,
    random_splats,
    small_manifest,
    write_stream,
)
from tests.support.slots.leases import LeasedStream, leased_streams, replayed


@pytest.mark.parametrize("num_layers", [1, 2, 3])
def test_every_frame_is_what_the_reader_says(tmp_path: Path, num_layers: int) -> None:
    reader = StreamReader(write_stream(tmp_path / "s", 13))
    ring = Ring(SWIN_SIZE, SLICE_SIZE, 1)
    for birth in range(1 - SWIN_SIZE, 13):
        ring.put(reader.slice(birth, num_layers))
        if birth >= 0:
            assert same_splats(ring.active(birth), reader.active_splats(birth, num_layers))


@given(leased_streams())
def test_changes_leave_what_a_plain_replay_leaves(stream: LeasedStream) -> None:
    ring = Ring(stream.swin_size, stream.slice_size, stream.sh_degree)
    for slice in stream.slices:
        ring.put(slice)
        # Some frames later, the oldest lanes are gone.
        for frame in range(slice.birth, slice.birth + stream.swin_size + 1):
            known = [one for one in stream.slices if one.birth <= slice.birth]
            lanes = replayed(known, frame, stream.swin_size)
            expected = Splats.concatenate([Splats.empty(stream.sh_degree), *lanes])
            assert same_splats(ring.active(frame), expected)


def test_what_does_not_fit_is_refused() -> None:
    def change(birth: int, row: int) -> Slice:
        rows = np.array([row], np.int32)
        return Slice(birth, random_splats(1, 0, 0), np.zeros(1, np.uint8), rows)

    ring = Ring(2, 3, 0)
    assert len(ring.active(0)) == 0
    for slice, refusal in (
        (random_slice(0, 4, 0), "4 Gaussians"),
        (random_slice(0, 3, 1), "SH degree 1"),
        (change(2, 0), "changes the one born at 0; its lane holds nothing"),
        (random_slice(0, 3, 0), None),
        (change(2, 3), "changes row 3; a lane has 3"),
        (change(2, 2), None),
        (change(6, 0), "its lane holds the one born at 2"),
    ):
        if refusal is None:
            ring.put(slice)
            continue
        with pytest.raises(InvalidError, match=refusal):
            ring.put(slice)


def test_the_cpu_renderer_shows_slices_from_their_birth_on() -> None:
    manifest = small_manifest(slice_size=50)
    cpu, ring = CpuRenderer(manifest), Ring(SWIN_SIZE, 50, 1)
    for birth in range(1 - SWIN_SIZE, 4):
        cpu.put(random_slice(birth, 50))
    for birth in range(1 - SWIN_SIZE, 4):
        ring.put(random_slice(birth, 50))
        if birth >= 0:
            expected = render_splats(ring.active(birth), manifest.camera(), manifest.near_m)
            np.testing.assert_array_equal(cpu.render(birth, manifest.camera()), expected)
    assert cpu.uploaded_bytes == (SWIN_SIZE + 3) * 50 * (4 * (3 + 3 + 4 + 1 + 12) + 1)
