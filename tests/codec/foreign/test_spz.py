"""SPZ 1 to 4: handmade bytes, axes, round trips, bombs and other hostile bytes."""

from __future__ import annotations

import gzip
import logging
import re
import struct
from dataclasses import replace

import numpy as np
import pytest
import zstandard
from hypothesis import given, settings

from codec.errors import CodecError, CorruptError, InvalidError, UnsupportedError
from codec.foreign.spz import SpzVersion, decode_spz, encode_spz
from codec.interop.formats import decode_any
from codec.similarity import harmonics
from codec.splats import Splats
from tests.support.alike import shapes
from tests.support.drawn import angles_rad, drawn_splats, same_splats
from tests.support.hostile import refused
from tests.support.trained_like import trained_like_splats

HALF = np.sqrt(0.5)


def fixed(*values: int) -> bytes:
    return b"".join(struct.pack("<i", value)[:3] for value in values)


# Two Gaussians of SH degree 1, array by array.
POSITIONS = fixed(4096, -4096, 1) + fixed(-8388608, 8388607, 0)
OPACITIES = bytes([51, 255])
COLOURS = bytes([255, 0, 51, 0, 0, 0])
SCALES = bytes([160, 0, 255, 160, 160, 160])
FIRST_THREE = bytes([255, 0, 0]) + bytes([0, 255, 255])  # too long: w is 0 then
# w (3) left out: x 0, y -511, z 0; then x (0) left out: y 0, z 0, w 511
SMALLEST_THREE = struct.pack("<2I", 3 << 30 | (512 | 511) << 10, 511)
HARMONICS = bytes([128, 0, 255, 192, 192, 192, 64, 64, 64]) + bytes([0] * 9)


def header(version: int, count: int = 2, degree: int = 1, bits: int = 12, flags: int = 0) -> bytes:
    return struct.pack("<4sIIBBBB", b"NGSP", version, count, degree, bits, flags, 0)


def legacy(version: int, rotations: bytes, extra: bytes = b"", flags: int = 0) -> bytes:
    arrays = POSITIONS + OPACITIES + COLOURS + SCALES + rotations + HARMONICS
    return gzip.compress(header(version, flags=flags) + arrays + extra)


def record(kind: int, content: bytes) -> bytes:
    return struct.pack("<II", kind, len(content)) + content


def axes(number: int) -> bytes:
    return record(0xADBE0003, struct.pack("<I", number))


ORBIT = record(0xADBE0002, bytes(12))


def version_4(extensions: bytes = b"", streaming: bool = False) -> bytes:
    arrays = [POSITIONS, OPACITIES, COLOURS, SCALES, SMALLEST_THREE, HARMONICS]
    compressor = zstandard.ZstdCompressor(write_content_size=not streaming)
    frames = [compressor.compress(array) for array in arrays]
    head = header(4, flags=2 if extensions else 0)[:15]
    head += struct.pack("<BI12x", len(arrays), 32 + len(extensions)) + extensions
    for frame, array in zip(frames, arrays, strict=True):
        head += struct.pack("<QQ", len(frame), len(array))
    return head + b"".join(frames)


ODD = "12 bytes that are no extension"


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (legacy(3, SMALLEST_THREE), ""),
        (legacy(3, SMALLEST_THREE, b"an extension", flags=2), ODD),
        (legacy(3, SMALLEST_THREE, axes(4) + ORBIT, flags=2), r"0xADBE0002 \(12 bytes\)$"),
        (legacy(3, SMALLEST_THREE, ORBIT), ""),
        (version_4(), ""),
        (version_4(b"an extension"), ODD),
        (version_4(axes(4) + record(7, b"")), r": 0x00000007 \(0 bytes\)$"),
        (version_4(6 * ORBIT), r"bytes\) and 2 more$"),
        (version_4(axes(0)), ""),
        (version_4(streaming=True), ""),
    ],
)
def test_spz_by_hand(data: bytes, says: str, caplog: pytest.LogCaptureFixture) -> None:
    splats = decode_any(data)
    assert len(caplog.messages) == bool(says)
    assert re.search(says, caplog.text.strip())
    # RUB to RDF: y and z change sign.
    assert splats.means.tolist() == [[1, 1, -1 / 4096], [-2048, -8388607 / 4096, 0]]
    assert splats.log_scales.tolist() == [[0, -10, 5.9375], [0, 0, 0]]
    assert splats.opacities == pytest.approx([0.2, 254.75 / 255], abs=1e-6)
    assert splats.sh[0, 0] == pytest.approx([0.5 / 0.15, -0.5 / 0.15, -0.3 / 0.15], abs=1e-5)
    assert splats.quats[0] == pytest.approx([HALF, 0, HALF, 0], abs=1e-6)
    assert splats.quats[1] == pytest.approx([HALF, HALF, 0, 0], abs=1e-6)
    # The order of the harmonics of degree 1 is y, z, x.
    assert splats.sh[0, 1:].tolist() == [[0, 1, -127 / 128], [-0.5, -0.5, -0.5], [-0.5, -0.5, -0.5]]


POINTS_TO = {
    **{"R": (1, 0, 0), "L": (-1, 0, 0), "D": (0, 1, 0)},
    **{"U": (0, -1, 0), "F": (0, 0, 1), "B": (0, 0, -1)},
}
"""Directions of letters in our frame."""
ORDER = "LDB RDB LUB RUB LDF RDF LUF RUF LFD RFD LFU RFU LBD RBD LBU RBU"


@pytest.mark.parametrize(("number", "name"), list(enumerate(ORDER.split(), 1)))
def test_the_axes_that_a_file_names(number: int, name: str) -> None:
    assumed, named = decode_any(version_4()), decode_any(version_4(axes(number)))
    # From right, up, back to the axes that the file names.
    turn = np.array([POINTS_TO[letter] for letter in name]).T @ np.diag([1.0, -1, -1])
    assert named.means == pytest.approx(assumed.means @ turn.T)
    assert shapes(named) == pytest.approx(turn @ shapes(assumed) @ turn.T, rel=1e-4, abs=1e-6)
    along = np.random.default_rng(4).normal(size=(10, 3))
    seen = [
        np.einsum("jk,nkc->njc", harmonics(directions)[:, :4], splats.sh)
        for splats, directions in ((assumed, along), (named, along @ turn.T))
    ]
    assert seen[1] == pytest.approx(seen[0], abs=1e-5)


def test_spz_1_keeps_half_floats() -> None:
    positions = np.array([[1, -1, 0.5], [-2, 0.1, 65504]], "<f2")
    data = legacy(2, FIRST_THREE)
    body = gzip.decompress(data)[16 + len(POSITIONS) :]
    splats = decode_any(gzip.compress(header(1) + positions.tobytes() + body))
    assert splats.means.tolist() == (positions.astype(np.float32) * [1, -1, -1]).tolist()
    assert splats.sh.tolist() == decode_any(data).sh.tolist()
    endless = np.array([[np.inf] * 3] * 2, "<f2").tobytes()
    refused(CorruptError, "not finite", decode_any, gzip.compress(header(1) + endless + body))


@given(drawn_splats(log_scale=(-10.0, 5.9), harmonic=0.99))
@settings(max_examples=80, deadline=None)
def test_spz_keeps_what_its_bits_can(splats: Splats) -> None:
    back = decode_any(encode_spz(splats))
    assert back.sh.shape == splats.sh.shape
    assert np.abs(back.means - splats.means).max(initial=0) <= 0.51 / 4096 + 1e-4
    assert np.abs(back.log_scales - splats.log_scales).max(initial=0) <= 0.501 / 16
    assert np.abs(back.opacities - splats.opacities).max(initial=0) <= 0.51 / 255
    assert np.abs(back.sh[:, 0] - splats.sh[:, 0]).max(initial=0) <= 0.501 / (0.15 * 255)
    assert np.abs(back.sh[:, 1:] - splats.sh[:, 1:]).max(initial=0) <= 0.501 / 128
    # Half a step of sqrt(1/2)/511 in three components; the fourth is at least as large as each.
    step = HALF / 511
    assert angles_rad(back, splats).max(initial=0) <= 2 * np.sqrt(3 + 9) * step / 2
    # A second trip changes nothing, except rotations whose two largest components tie after
    # rounding: which of them is left out may change, and with it the last bit of the others.
    again = decode_any(encode_spz(back))
    for name in ("means", "log_scales", "logit_opacities", "sh"):
        assert (getattr(again, name) == getattr(back, name)).all()
    assert angles_rad(again, back).max(initial=0) <= 2 * np.sqrt(3 + 9) * step / 2


@given(drawn_splats(log_scale=(-10.0, 5.9), harmonic=0.99))
@settings(max_examples=40, deadline=None)
def test_versions_differ_in_rotations_alone(splats: Splats) -> None:
    third, fourth = encode_spz(splats), encode_spz(splats, SpzVersion.V4)
    assert gzip.decompress(third)[:8] == b"NGSP\3\0\0\0"
    assert gzip.decompress(third).endswith(axes(4))
    assert fourth[32:44] == axes(4)
    assert same_splats(decode_any(third), decode_any(fourth))
    second = encode_spz(splats, SpzVersion.V2)
    assert gzip.decompress(second)[:8] == b"NGSP\2\0\0\0"
    back = decode_any(second)
    for name in ("means", "log_scales", "logit_opacities", "sh"):
        assert (getattr(back, name) == getattr(decode_any(third), name)).all()
    # x, y and z in 8 bits of -1..1; w makes them a unit vector, but is never below 0.
    unit = splats.quats / np.linalg.norm(splats.quats, axis=1, keepdims=True)
    unit *= np.where(unit[:, :1] < 0, -1, 1)
    assert np.abs(back.quats - unit)[:, 1:].max(initial=0) <= 0.51 / 127.5


def test_a_huge_scene_trades_precision_for_range() -> None:
    splats = trained_like_splats(3)
    far = replace(splats, means=splats.means * np.float32(1e5))
    back = decode_spz(encode_spz(far))
    bits = encode_spz(far, SpzVersion.V4)[13]
    assert bits < 12
    assert np.abs(back.means - far.means).max() <= 0.51 / (1 << bits)
    with pytest.raises(InvalidError, match="at most 8388607"):
        encode_spz(replace(far, means=far.means * np.float32(1e5)))


def test_opacity_compensation_is_not_lost_in_silence(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        decode_spz(legacy(3, SMALLEST_THREE, flags=1))
    assert "opacity compensation" in caplog.text


def altered(data: bytes, place: int, value: bytes) -> bytes:
    return data[:place] + value + data[place + len(value) :]


@pytest.mark.parametrize(
    ("data", "kind", "says"),
    [
        (b"NGSP", CorruptError, "header of 32"),
        (gzip.compress(b"NGSP"), CorruptError, "header of 16"),
        (gzip.compress(b"PSGN" + bytes(12)), CorruptError, "NGSP"),
        (gzip.compress(header(0)), UnsupportedError, "version 0; .* 1 or 2 or 3"),
        (gzip.compress(header(4)), UnsupportedError, "version 4"),
        (header(3) + bytes(16), UnsupportedError, "must be 4"),
        (gzip.compress(header(3, degree=4)), UnsupportedError, "SH degree 4"),
        (gzip.compress(header(3, bits=24)), CorruptError, "24 fractional bits"),
        (gzip.compress(header(3)), CorruptError, "that 2 Gaussians need"),
        (legacy(3, SMALLEST_THREE, bytes(2 << 20)), CorruptError, "not the"),
        (b"\x1f\x8bnonsense", CorruptError, "SPZ: "),
        (version_4(axes(17)), UnsupportedError, "axes 17; this program knows 1 to 16"),
        (altered(version_4(), 15, b"\5"), CorruptError, "5 arrays, not 6"),
        (altered(version_4(), 16, b"\x1f"), CorruptError, "outside"),
        (altered(version_4(), 18, b"\xff"), CorruptError, "outside"),
        (altered(version_4(), 40, b"\x13"), CorruptError, "19 bytes, not 18"),
        (altered(version_4(), 32, b"\xff" * 8), CorruptError, "ends inside an array"),
        (altered(version_4(), 8, b"\3"), CorruptError, "18 bytes, not 27"),
    ],
)
def test_a_bad_spz_is_refused(data: bytes, kind: type[CodecError], says: str) -> None:
    refused(kind, says, decode_any, data)
