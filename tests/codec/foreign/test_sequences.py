"""Handmade .4dgs and .splat4d; interop/test_neighbours.py uses the programs of their authors."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np
import pytest

from codec.errors import CodecError
from codec.foreign.fourdgs import FourdgsReader
from codec.foreign.splat4d import Splat4dReader
from codec.splats import SH_C0, Splats
from tests.support import handmade_sequences as made
from tests.support.handmade_sequences import (
    MAGIC,
    delta,
    fourdgs,
    grids,
    group,
    header,
    keyframe,
    splat4d,
)
from tests.support.hostile import within_bytes

FRONT = header(), grids(), made.windows((0, 10))
AT = len(MAGIC) + sum(map(len, FRONT))
KEY = keyframe(0, 0.5, 2, group([7, 4], a0=[[1, 2, 3], [4, 5, 6]], a5=[[255], [51]]))
MOVED = made.stream(13, [[4]]) + made.stream(0, [[1, 0, -1]])
SECOND = delta((0.5, 1), AT, (MOVED, group([9]), made.stream(13, [[7]])), (1, 1, 1))


def read(tmp_path: Path, data: bytes, max_gaussians: int = 1000) -> list[Splats]:
    path = tmp_path / "a.4dgs"
    path.write_bytes(data)
    reader = FourdgsReader(path)
    return [reader.read(frame, max_gaussians) for frame in range(reader.num_frames)]


def test_4dgs_by_hand(tmp_path: Path) -> None:
    first, second = read(tmp_path, fourdgs(*FRONT, KEY, SECOND))
    assert first.means == pytest.approx(np.array([[1.01, 2.02, 3.03], [1.04, 2.05, 3.06]]))
    assert second.means == pytest.approx(np.array([[1.05, 2.05, 3.05], [1, 2, 3]]))
    assert first.opacities == pytest.approx([1 - 1 / 1020, 0.2], abs=1e-6)
    assert first.log_scales.tolist() == [[0] * 3] * 2
    assert first.quats.tolist() == [[0, 1, 0, 0]] * 2  # xyzw: the first is largest
    assert first.sh == pytest.approx(np.full((2, 1, 3), -0.5 / SH_C0))


def test_what_a_few_bytes_claim_costs_no_memory(tmp_path: Path) -> None:
    many = 1 << 24
    constant = struct.pack("<BBBBBIQ", 13, 1, 2, 0, 1, many, 9) + zlib.compress(b"\0")
    huge = struct.pack("<2d2I", 0, 1, 0, 1) + made.text("deflate")
    huge += struct.pack("<Q", 1 << 29) + made.block(zlib.compress(bytes(1 << 20)))
    for state in (keyframe(0, 1, many, constant), made.record(5, huge)):
        with within_bytes(8 << 20), pytest.raises(CodecError, match="claims to decompress"):
            read(tmp_path, fourdgs(*FRONT, state), many)


def read_splat4d(tmp_path: Path, data: bytes, max_gaussians: int = 1000) -> list[Splats]:
    path = tmp_path / "a.splat4d"
    path.write_bytes(data)
    reader = Splat4dReader(path)
    return [reader.read(frame, max_gaussians) for frame in range(reader.num_frames)]


def test_splat4d_by_hand(tmp_path: Path) -> None:
    frames = read_splat4d(tmp_path, splat4d())
    # The middle Gaussian has no opacity in the first frame.
    assert [len(splats) for splats in frames] == [2, 3, 3]
    assert frames[0].means.tolist() == [[2.5, -5, 7.5], [3, -5, 7.5]]
    assert frames[0].log_scales == pytest.approx(np.array([[-3, -4, -5]] * 2))
    assert frames[0].quats == pytest.approx(np.array([[127 / 128, 0, 0, 0]] * 2))
    assert 255 * (0.5 + SH_C0 * frames[0].sh[0, 0]) == pytest.approx([255, 0, 128], abs=1e-3)
    for number in (1, 2):
        middle = frames[number].take(slice(1, 2))
        assert middle.means.tolist() == [[(6 + number) * 0.5, number * 0.5, number * 0.5]]
        assert middle.log_scales == pytest.approx(np.full((1, 3), 0.2 * (number - 9)))
        turns = np.array([[100, 10, 0, 0]]) + number
        assert middle.quats == pytest.approx(turns / 128)
        assert 255 * middle.opacities == pytest.approx([number], abs=1e-3)
