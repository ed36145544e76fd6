"""Handmade .splat4d containers, valid and invalid; tests/codec/interop/test_neighbours.py uses the
program of the format's authors."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from codec.errors import CorruptError, UnsupportedError
from codec.foreign.splat4d import Splat4dReader
from codec.splats import SH_C0, Splats
from tests.support.handmade_sequences import DIFFERENCES, KEYS, splat4d
from tests.support.hostile import within_bytes


def read(tmp_path: Path, data: bytes, max_gaussians: int = 1000) -> list[Splats]:
    path = tmp_path / "a.splat4d"
    path.write_bytes(data)
    reader = Splat4dReader(path)
    return [reader.read(frame, max_gaussians) for frame in range(reader.num_frames)]


def test_splat4d_by_hand(tmp_path: Path) -> None:
    frames = read(tmp_path, splat4d())
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


STEPS = {
    **{"pos": 0.5, "rot": 1, "rgb": 1, "alpha": 1, "scale_log": 0.2},
    **{"base_pos": 1e999, "base_scale_log": 0.1},
}
GOP = {"offset": 1000, "len": 1, "f0": 0, "f1": 2}
BAD: dict[str, tuple[dict[str, Any], str]] = {
    "too many": ({"json_changes": {"n": 1001}}, "at most 1000"),
    "more than the file can hold": ({"json_changes": {"n": 1 << 24}}, "claims to decompress"),
    "no Gaussians": ({"json_changes": {"n": "3"}}, "is not a whole number"),
    "an endless step": ({"json_changes": {"steps": STEPS}}, "base_pos: is not a finite number"),
    "no chunks": ({"json_changes": {"gops": []}}, "do not hold its frames"),
    "a frame more": ({"json_changes": {"t": 4}}, "do not hold its frames"),
    "a gap": ({"json_changes": {"gops": [GOP | {"f1": 0}, GOP | {"f0": 2}]}}, "do not follow"),
    "a chunk outside": ({"json_changes": {"gops": [GOP | {"len": 1 << 20}]}}, "are not there"),
    "a chunk cut off": ({"json_changes": {"gops": [GOP]}}, "too early"),
    "a short mask": ({"masks": [[0, 0]] * 5}, "2 numbers of 1 bytes, not 1"),
    "a missing key": ({"keys": {k: v for k, v in KEYS.items() if k}}, "of attribute 0 is missing"),
    "a missing difference": (
        {"differences": {k: v for k, v in DIFFERENCES.items() if k}},
        "of attribute 0 is missing",
    ),
    "an odd attribute": ({"keys": KEYS | {5: [[0]]}}, "a stream of attribute 5"),
    "no turn": ({"rotations": [[128] * 4] * 3}, "zero quaternion"),
}


@pytest.mark.parametrize("name", BAD)
def test_a_bad_splat4d_is_refused_with_the_reason(name: str, tmp_path: Path) -> None:
    changes, says = BAD[name]
    data = splat4d(**changes)
    with (
        within_bytes(8 << 20),
        pytest.raises((CorruptError, UnsupportedError), match=says) as caught,
    ):
        read(tmp_path, data)
    assert "\n" not in str(caught.value)


def test_another_version_and_a_short_file(tmp_path: Path) -> None:
    with pytest.raises(UnsupportedError, match="version 2; this program reads 1"):
        read(tmp_path, b"SP4D\2" + splat4d()[5:])
    with pytest.raises(CorruptError, match="ends inside its header"):
        read(tmp_path, splat4d()[:7])
