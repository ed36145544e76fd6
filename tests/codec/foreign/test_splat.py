""".splat and .ksplat: what a reader must refuse; interop/test_others.py has other programs read and
write them."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings

from codec.errors import CorruptError, UnsupportedError
from codec.foreign.ksplat import decode_ksplat
from codec.foreign.splat import decode_splat, encode_splat
from codec.interop.formats import decode_any
from codec.splats import SH_C0, Splats
from tests.support.drawn import angles_rad, drawn_splats
from tests.support.hostile import refused, survives

RECORD = struct.Struct("<3f3f4B4B")
BY_HAND = RECORD.pack(1, -2, 3, 0.5, 1, 2, 255, 0, 51, 102, 228, 128, 28, 128) + RECORD.pack(
    0, 0, 0, 0, 1e-3, 1e-3, 128, 128, 128, 0, 255, 128, 128, 128
)


decode_any_splat = partial(decode_any, suffix=".SPLAT")


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
    refused(CorruptError, says, decode_splat, data)


def test_only_whole_records_are_read() -> None:
    for length in range(len(BY_HAND) + 1):  # the second is flat: its scale has no logarithm
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


FORMATS = {0: "<3f3f4f4B", 1: "<3H3e4e4B", 2: "<3H3e4e4B"}
HARMONICS = {0: "f", 1: "e", 2: "B"}
RGBA = (255, 0, 51, 102)


def section(
    level: int,
    records: list[tuple[Any, ...]],
    centres: Sequence[tuple[float, ...]] = (),
    lengths: tuple[int, ...] = (),
    **changes: Any,
) -> tuple[bytes, bytes]:
    """Header and content of a section: two Gaussians in a full bucket, one in a partial one."""
    said = {
        **{"count": len(records), "room": len(records), "size": 2, "buckets": len(centres)},
        **{"block": 5.0, "bucket_bytes": 12 if level else 0, "reach": 0},
        **{"full": len(centres) - len(lengths), "partial": len(lengths), "degree": 0},
    } | changes
    degree = said["degree"]
    extra = 3 * ((degree + 1) ** 2 - 1)
    head = struct.pack("<IIIIfHxxI4xIIH", *said.values()).ljust(1024, b"\0")
    layout = FORMATS[level] + f"{extra}{HARMONICS[level]}" * bool(extra)
    content = struct.pack(f"<{len(lengths)}I", *lengths)
    content += b"".join(struct.pack("<3f", *centre) for centre in centres)
    return head, content + b"".join(struct.pack(layout, *values) for values in records)


def ksplat(
    level: int,
    *sections: tuple[bytes, bytes],
    count: int,
    version: tuple[int, int] = (0, 1),
    reach: tuple[float, float] = (0, 0),
) -> bytes:
    number = len(sections)
    head = struct.pack("<BBxxIIIIHxx12xff", *version, number, number, count, count, level, *reach)
    heads, contents = zip(*sections, strict=True)
    return head.ljust(4096, b"\0") + b"".join(heads) + b"".join(contents)


FLOATS = (1.0, -2.0, 3.0, 1.0, 0.5, 0.0, 0.5, 0.5, -0.5, 0.5, *RGBA)
PLAIN = ksplat(0, section(0, [FLOATS]), count=1)
CODES = [
    (32767, 32767, 32767, 1, 0.5, 0.25, 1, 0, 0, 0, *RGBA),
    (0, 32767, 65534, 1, 0.5, 0.25, 1, 0, 0, 0, *RGBA),
    (32767, 32767, 32767, 1, 0.5, 0.25, 1, 0, 0, 0, *RGBA),
]
CENTRES = [(1.0, 2.0, 3.0), (-10.0, 0.0, 10.0)]
BUCKETS = ksplat(1, section(1, CODES, CENTRES, (1,)), count=3)


def test_buckets() -> None:
    assert decode_any(PLAIN, ".ksplat").log_scales[0, 2] < -80  # flat
    splats = decode_ksplat(BUCKETS)
    assert splats.means == pytest.approx(np.array([[1, 2, 3], [-1.5, 2, 5.5], [-10, 0, 10]]))
    refused(UnsupportedError, "at most 2", decode_ksplat, BUCKETS, 2)


def test_harmonics_of_two_sections() -> None:
    """Harmonics of degree 2 and of degree 0, in bytes between -1 and 2.825."""
    codes = tuple(range(24))
    sections = (
        section(2, [(*CODES[0], *codes)], CENTRES[:1], (1,), degree=2),
        section(2, [CODES[0]], CENTRES[:1], (1,)),
    )
    splats = decode_ksplat(ksplat(2, *sections, count=2, reach=(-1, 2.825)))
    first = np.array(codes[:9]).reshape(3, 3).T
    second = np.array(codes[9:]).reshape(3, 5).T
    wanted = np.concatenate([first, second]) * 0.015 - 1
    assert splats.sh[0, 1:] == pytest.approx(wanted, abs=1e-6)
    assert not splats.sh[1, 1:].any()


BAD = {
    "short": (PLAIN[:4000], "ends inside its header"),
    "cut off": (PLAIN[:-1], "ends after 5163 bytes of 5164"),
    "version": (ksplat(0, section(0, [FLOATS]), count=1, version=(1, 0)), "version 1.0"),
    "level": (PLAIN[:20] + b"\3" + PLAIN[21:], "level 3"),
    "sections": (PLAIN[:4] + b"\xff" * 4 + PLAIN[8:], "claims 4294967295 sections"),
    "too many": (PLAIN[:16] + b"\xff" * 4 + PLAIN[20:], "claims 4294967295 Gaussians"),
    "another count": (ksplat(0, section(0, [FLOATS]), count=2), "not 2 Gaussians"),
    "degree 3": (ksplat(0, section(0, [(*FLOATS, *[0.0] * 45)], degree=3), count=1), "degree 3"),
    "no room": (ksplat(0, section(0, [FLOATS], room=0), count=1), "more Gaussians than room"),
    "no bucket": (ksplat(1, section(1, CODES, CENTRES, (0,)), count=3), "is in no bucket"),
    "odd buckets": (ksplat(1, section(1, CODES, CENTRES, size=1, full=9), count=3), "in no bucket"),
    "negative": (ksplat(0, section(0, [(*FLOATS[:3], -1.0, *FLOATS[4:])]), count=1), "negative"),
    "NaN": (ksplat(0, section(0, [(np.nan, *FLOATS[1:])]), count=1), "not finite"),
}


@pytest.mark.parametrize("name", BAD)
def test_a_bad_ksplat_is_refused_with_the_reason(name: str) -> None:
    data, says = BAD[name]
    assert "\n" not in str(refused((CorruptError, UnsupportedError), says, decode_ksplat, data))
