"""Handmade .4dgs and .splat4d; interop/test_neighbours.py uses the programs of their authors."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from codec.errors import CodecError, CorruptError, UnsupportedError
from codec.foreign.fourdgs import FourdgsReader
from codec.foreign.splat4d import Splat4dReader
from codec.splats import SH_C0, Splats
from tests.support import handmade_sequences as made
from tests.support.handmade_sequences import (
    DIFFERENCES,
    KEYS,
    MAGIC,
    delta,
    fourdgs,
    grids,
    group,
    header,
    keyframe,
    splat4d,
)
from tests.support.hostile import refused, within_bytes

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


def test_colours_turns_and_sizes(tmp_path: Path) -> None:
    streams = group([0], a1=[[1, -2, 50]], a2=[[3]], a3=[[600, 0, 0]], a4=[[100, 50, -50]])
    [splats] = read(tmp_path, fourdgs(*FRONT, keyframe(0, 1, 1, streams, "deflate")))
    assert splats.log_scales[0] == pytest.approx([0.02, -0.04, 1])
    assert splats.quats[0] == pytest.approx([0.8, 0.6, 0, 0])
    shown = 255 * (0.5 + SH_C0 * splats.sh[0, 0])
    assert shown == pytest.approx([150, 100, 50], abs=1e-3)


def test_motion_fading_and_windows(tmp_path: Path) -> None:
    """One state for two frames and one for a single frame, with frames of half a second."""
    streams = group(
        [0, 1, 2],
        # ln sigma / 0.02, no fading for the last two; time 0.25 s; motion.
        **{"a8": [[-35], [0], [0]], "a9": [[0], [1], [1]], "a7": [[0]] * 3},
        **{"a6": [[10, 0, 0], [0, 10, 0], [0, 0, 0]], "a10": [[0], [0], [1]], "a5": [[200]] * 3},
    )
    last = keyframe(1, 1.5, 0, b"")
    spans = made.windows((0, 10), (0.5, 10))
    frames = read(tmp_path, fourdgs(header(), grids(), spans, keyframe(0, 1, 3, streams), last))
    assert [len(splats) for splats in frames] == [2, 3, 0]
    sigma = np.exp(-0.7)
    assert frames[0].means[0].tolist() == [1, 2, 3]
    # Half of a 1.2 s life is in the class up to 2 s: a quarter of the step, and 2 s of window.
    assert frames[1].means[0] == pytest.approx([1 + 10 * 0.1 / 4 * 0.5, 2, 3])
    assert frames[1].means[1] == pytest.approx([1, 2 + 10 * 0.1 / 4 * 0.5, 3])
    faded = 200 / 255 * np.exp(-0.5 * (0.5 / sigma) ** 2)
    assert frames[1].opacities == pytest.approx([faded, 200 / 255, 200 / 255], rel=1e-5)


def test_harmonics_come_in_bands(tmp_path: Path) -> None:
    codes = np.arange(18).reshape(2, 9)
    front = header(sh_degree=1), *FRONT[1:]
    band = made.record(7, b"\1" + made.stream(7, codes))
    born = made.record(7, b"\1" + made.stream(7, codes[:1] + 100))
    after = delta((0.5, 1), AT, (b"", group([9]), b""), (0, 1, 0))
    frames = read(tmp_path, fourdgs(*front, KEY, band, after, born))
    wanted = codes.reshape(2, 3, 3).swapaxes(1, 2) * 8 / 255 - 4
    assert frames[0].sh[:, 1:] == pytest.approx(wanted, abs=1e-6)
    assert frames[1].sh[:, 1:] == pytest.approx(
        np.concatenate([wanted, wanted[:1] + 800 / 255]), abs=1e-6
    )


BAD: dict[str, tuple[Callable[[], bytes], str]] = {
    "empty": (lambda: MAGIC, "has no states"),
    "cut off": (lambda: fourdgs(*FRONT, KEY)[:-40], "ends after the file"),
    "another model": (lambda: fourdgs(header("gaussian-birth"), KEY), "'gaussian-birth'; this"),
    "other grids": (lambda: fourdgs(header(), grids(scheme="x"), KEY), "the grids 'x'"),
    "no steps": (lambda: fourdgs(header(), grids((np.inf,) * 8), KEY), "without a finite step"),
    "no cutoff": (lambda: fourdgs(header(cutoff=0), KEY), "out of range"),
    "no grids": (lambda: fourdgs(header(), KEY), "before what it needs"),
    "begins late": (lambda: fourdgs(*FRONT, keyframe(1, 2, 0, b"")), "shows from 1.0"),
    "backwards": (lambda: fourdgs(*FRONT, keyframe(0, 0, 0, b"")), "shows from 0.0"),
    "uneven": (
        lambda: fourdgs(*FRONT, keyframe(0, 1, 0, b""), keyframe(1, 2.5, 0, b"")),
        "not a whole number of frames",
    ),
    "objects": (lambda: fourdgs(*FRONT, made.record(0x25, b""), KEY), "move as one"),
    "begins with a delta": (
        lambda: fourdgs(*FRONT, delta((0, 0.5), AT, (b"", b"", b""), (0, 0, 0))),
        "begins with a delta",
    ),
    "an odd reference": (
        lambda: fourdgs(*FRONT, KEY, delta((0.5, 1), 3, (b"", b"", b""), (0, 0, 0))),
        "follows neither",
    ),
    "too many": (lambda: fourdgs(*FRONT, keyframe(0, 1, 1001, group([0]))), "at most 1000"),
    "another count": (lambda: fourdgs(*FRONT, keyframe(0, 1, 3, group([0]))), "numbers, not 3"),
    "the same twice": (lambda: fourdgs(*FRONT, keyframe(0, 1, 2, group([5, 5]))), "comes twice"),
    "a stream twice": (
        lambda: fourdgs(*FRONT, keyframe(0, 1, 1, group([5]) + made.stream(5, [[1]]))),
        "attribute 5 comes twice",
    ),
    "something missing": (
        lambda: fourdgs(*FRONT, keyframe(0, 1, 1, made.stream(13, [[1]]))),
        "attribute 0 is missing",
    ),
    "an odd window": (lambda: fourdgs(*FRONT, keyframe(0, 1, 1, group([0], a10=[[1]]))), "window"),
    "an odd component": (
        lambda: fourdgs(*FRONT, keyframe(0, 1, 1, group([0], a2=[[4]]))),
        "component of 4",
    ),
    "an odd codec": (lambda: fourdgs(*FRONT, keyframe(0, 1, 1, group([0]), "lz4")), "packed by"),
    "who is not there dies": (
        lambda: fourdgs(
            *FRONT, KEY, delta((0.5, 1), AT, (b"", b"", made.stream(13, [[8]])), (0, 0, 1))
        ),
        "that is not there",
    ),
    "born again": (
        lambda: fourdgs(*FRONT, KEY, delta((0.5, 1), AT, (b"", group([4]), b""), (0, 1, 0))),
        "there already",
    ),
    "a fixed attribute": (
        lambda: fourdgs(*FRONT, KEY, delta((0.5, 1), AT, (group([4]), b"", b""), (1, 0, 0))),
        "cannot be changed by itself",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_a_bad_4dgs_is_refused_with_the_reason(name: str, tmp_path: Path) -> None:
    make, says = BAD[name]
    assert "\n" not in str(refused((CorruptError, UnsupportedError), says, read, tmp_path, make()))


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


STEPS = {
    **{"pos": 0.5, "rot": 1, "rgb": 1, "alpha": 1, "scale_log": 0.2},
    **{"base_pos": 1e999, "base_scale_log": 0.1},
}
GOP = {"offset": 1000, "len": 1, "f0": 0, "f1": 2}
BAD_SPLAT4D: dict[str, tuple[dict[str, Any], str]] = {
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


@pytest.mark.parametrize("name", BAD_SPLAT4D)
def test_a_bad_splat4d_is_refused_with_the_reason(name: str, tmp_path: Path) -> None:
    changes, says = BAD_SPLAT4D[name]
    data = splat4d(**changes)
    with (
        within_bytes(8 << 20),
        pytest.raises((CorruptError, UnsupportedError), match=says) as caught,
    ):
        read_splat4d(tmp_path, data)
    assert "\n" not in str(caught.value)


def test_another_version_and_a_short_file(tmp_path: Path) -> None:
    with pytest.raises(UnsupportedError, match="version 2; this program reads 1"):
        read_splat4d(tmp_path, b"SP4D\2" + splat4d()[5:])
    refused(CorruptError, "ends inside its header", read_splat4d, tmp_path, splat4d()[:7])
