""".splat: handmade bytes, round trips, hostile bytes."""

from __future__ import annotations

import struct
from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings

from codec.errors import CorruptError
from codec.foreign.splat import decode_splat, encode_splat
from codec.interop.formats import decode_any
from codec.splats import SH_C0, Splats
from tests.support.drawn import angles_rad, drawn_splats
from tests.support.hostile import survives
from tests.support.trained_like import trained_like_splats

RECORD = struct.Struct("<3f3f4B4B")
BY_HAND = RECORD.pack(1, -2, 3, 0.5, 1, 2, 255, 0, 51, 102, 228, 128, 28, 128) + RECORD.pack(
    0, 0, 0, 0, 1e-3, 1e-3, 128, 128, 128, 0, 255, 128, 128, 128
)


decode_any_splat = partial(decode_any, suffix=".splat")


def test_splat_by_hand() -> None:
    splats = decode_any(BY_HAND, ".SPLAT")
    assert splats.means.tolist() == [[1, -2, 3], [0, 0, 0]]
    assert np.exp(splats.log_scales[0]) == pytest.approx([0.5, 1, 2])
    assert np.isfinite(splats.log_scales[1, 0])  # flat, but a logarithm
    assert 0.5 + SH_C0 * splats.sh[0, 0] == pytest.approx([1, 0, 0.2], abs=1e-6)
    assert splats.quats[0].tolist() == [100 / 128, 0, -100 / 128, 0]
    assert splats.opacities == pytest.approx([0.4, 0.25 / 255], abs=1e-6)


def test_splat_is_written_as_by_hand() -> None:
    root = np.sqrt(np.float32(0.5))
    splats = Splats(
        np.array([[1, -2, 3]], np.float32),
        np.log(np.array([[0.5, 1, 2]], np.float32)),
        np.array([[3 * root, 0, -3 * root, 0]], np.float32),
        np.array([np.log(0.4 / 0.6)], np.float32),
        ((np.array([[[1.5, 0, 0.2]]]) - 0.5) / SH_C0).astype(np.float32),
    )
    # 128 + 128 / sqrt(2) = 218.5 to the nearest
    expected = (1, -2, 3, 0.5, 1, 2, 255, 0, 51, 102, 219, 128, 37, 128)
    assert RECORD.unpack(encode_splat(splats)) == pytest.approx(expected)


@given(drawn_splats(max_degree=0, harmonic=1.7))
@settings(max_examples=80, deadline=None)
def test_splat_keeps_what_its_bits_can(splats: Splats) -> None:
    importance = splats.log_scales.astype(np.float64).sum(axis=1) + np.log(splats.opacities)
    splats = splats.take(np.argsort(-importance, kind="stable"))
    back = decode_splat(encode_splat(splats))
    assert np.array_equal(back.means, splats.means)
    assert np.allclose(back.log_scales, splats.log_scales, atol=1e-5)
    assert np.abs(back.opacities - splats.opacities).max(initial=0) <= 0.51 / 255
    rgb = np.clip(0.5 + SH_C0 * splats.sh, 0, 1)
    assert np.abs(0.5 + SH_C0 * back.sh - rgb).max(initial=0) <= 0.51 / 255
    # Half a step in each of four components, and a whole step where 1 is clipped to 127 / 128.
    assert angles_rad(back, splats).max(initial=0) <= 2 * np.sqrt(4 * 0.5**2 + 1) / 128
    assert len(encode_splat(splats)) == 32 * len(splats)
    # Rounding a second time changes nothing.
    if len(splats):
        again = decode_splat(encode_splat(back))
        assert np.array_equal(np.sort(again.logit_opacities), np.sort(back.logit_opacities))


def test_splat_is_written_most_important_first() -> None:
    splats = decode_splat(encode_splat(trained_like_splats(200)))
    importance = splats.log_scales.astype(np.float64).sum(axis=1) + np.log(splats.opacities)
    assert (np.diff(importance) < 0.1).all()


@pytest.mark.parametrize(
    ("place", "value", "says"),
    [
        (12, struct.pack("<f", -1), "negative"),
        (16, struct.pack("<f", np.nan), "not a number"),
        (0, struct.pack("<f", np.inf), "not finite"),
        (28, bytes([128] * 4), "zero quaternion"),
    ],
)
def test_a_bad_splat_is_refused_with_the_reason(place: int, value: bytes, says: str) -> None:
    data = BY_HAND[:place] + value + BY_HAND[place + len(value) :]
    with pytest.raises(CorruptError, match=says):
        decode_splat(data)


def test_only_whole_records_are_read() -> None:
    for length in range(len(BY_HAND)):
        assert survives(decode_any_splat, BY_HAND[:length]) == (length % 32 == 0)


def test_extreme_gaussians_stay_readable() -> None:
    splats = Splats(
        np.zeros((2, 3), np.float32),
        np.array([[200] * 3, [-200] * 3], np.float32),
        np.array([[1e-30, 0, 0, 0], [3e38, 3e38, 0, 0]], np.float32),
        np.array([-500, 500], np.float32),
        np.full((2, 1, 3), 1e30, np.float32),
    )
    assert len(decode_splat(encode_splat(splats))) == 2
