"""Files of Gaussians by name and first bytes, and one real model in two formats."""

from __future__ import annotations

import gzip
import os
import struct
from pathlib import Path

import numpy as np
import pytest

from codec.errors import CodecError, CorruptError, UnsupportedError
from codec.foreign.limits import MAX_GAUSSIANS
from codec.foreign.spz import SpzVersion
from codec.interop.formats import (
    MAX_FILE_BYTES,
    SplatFormat,
    decode_any,
    encode_splats,
    read_splats,
    write_splats,
)
from codec.splats import SH_C0
from tests.support.commands import ROOT
from tests.support.drawn import angles_rad, same_splats
from tests.support.hostile import survives, truncations, within_bytes
from tests.support.trained_like import trained_like_splats

MODELS = Path(os.environ.get("SWINGS_DATA", ROOT / ".." / "shared" / "data")) / "splats"


@pytest.mark.parametrize("format", list(SplatFormat))
def test_what_is_written_is_read_by_its_name(format: SplatFormat, tmp_path: Path) -> None:
    splats = trained_like_splats(50)
    path = tmp_path / f"model.{format}"
    assert write_splats(path, splats, format) == path.stat().st_size
    back = read_splats(path)
    assert len(back) == 50
    assert np.sort(back.means[:, 0]) == pytest.approx(np.sort(splats.means[:, 0]), abs=2e-4)
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


def test_an_unreadable_file_is_named(tmp_path: Path) -> None:
    path = tmp_path / "model.ply"
    with pytest.raises(CorruptError, match=r"model\.ply is missing$"):
        read_splats(path)
    with pytest.raises(CorruptError, match="cannot be read: Is a directory"):
        read_splats(tmp_path)
    path.write_bytes(b"GIF89a and so on")
    with pytest.raises(UnsupportedError, match=r"model\.ply: starts with b'GIF8'; this program"):
        read_splats(path)
    for format in SplatFormat:
        path = tmp_path / f"empty.{format}"
        path.touch()
        if format is SplatFormat.SPLAT:  # without a header, an empty file has no Gaussians
            assert len(read_splats(path)) == 0
            continue
        with pytest.raises(CorruptError, match=rf"empty\.{format}: is empty; this program reads"):
            read_splats(path)
    # The first bytes count more than a wrong name.
    splats = trained_like_splats(5)
    write_splats(tmp_path / "model.spz", splats, SplatFormat.PLY)
    assert same_splats(read_splats(tmp_path / "model.spz"), splats)


@pytest.mark.parametrize(
    ("format", "version"),
    [(f, None) for f in SplatFormat if f not in ("splat", "spz")]
    + [(SplatFormat.SPZ, version) for version in SpzVersion],
)
def test_no_part_of_a_file_is_a_file(format: SplatFormat, version: SpzVersion | None) -> None:
    data = encode_splats(trained_like_splats(2, sh_degree=1), format, version)
    parts = list(truncations(data))[:: 1 if len(data) < 1000 else 37]
    assert not [len(part) for part in parts if survives(decode_any, part)]


def test_a_failed_write_leaves_the_old_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "model.ply"
    write_splats(path, trained_like_splats(5), SplatFormat.PLY)
    before = path.read_bytes()

    def full(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space"):
        write_splats(path, trained_like_splats(6), SplatFormat.PLY)
    assert path.read_bytes() == before


@pytest.mark.skipif(
    not (MODELS / "biker.spz").exists(), reason=f"no biker.spz in {MODELS} (set SWINGS_DATA)"
)
def test_one_model_from_two_formats_is_the_same_within_their_precision() -> None:
    """SuperSplat wrote both files, Gaussian for Gaussian in the same order."""
    packed = read_splats(MODELS / "biker.compressed.ply")
    spz = read_splats(MODELS / "biker.spz")
    assert len(packed) == len(spz) == 152_746
    assert packed.sh.shape == spz.sh.shape == (152_746, 1, 3)
    assert np.abs(packed.means - spz.means).max() <= 0.51 / 4096
    assert np.abs(packed.opacities - spz.opacities).max() < 1e-6
    assert np.abs(packed.sh - spz.sh).max() <= 0.51 / (0.15 * 255)
    scales = np.maximum(packed.log_scales, -10)  # the minimum of SPZ
    assert np.abs(scales - spz.log_scales).max() <= 0.51 / 16
    assert angles_rad(packed, spz).max() < 0.004
    # Both are in our frame: the feet are at y = 0, y down, as in the PLY.
    assert packed.means[:, 1].min() < -1.5
    assert abs(packed.means[:, 1].max()) < 0.01
    assert 0 < np.median(0.5 + SH_C0 * packed.sh) < 1


HUGE_BYTES = 4_000_000_000
"""Size of a sparse file, which takes no space; it is below MAX_FILE_BYTES."""
FLOATS = [*"xyz", *(f"f_dc_{i}" for i in range(3)), *(f"f_rest_{i}" for i in range(45))]
FLOATS += ["opacity", *(f"scale_{i}" for i in range(3)), *(f"rot_{i}" for i in range(4))]


def ply_head(count: int, layout: str = "binary_little_endian") -> bytes:
    lines = ["ply", f"format {layout} 1.0", f"element vertex {count}"]
    return "\n".join([*lines, *(f"property float {n}" for n in FLOATS), "end_header\n"]).encode()


def spz_head(count: int, version: int = 4) -> bytes:
    return struct.pack("<4sIIBBBBI12x", b"NGSP", version, count, 0, 12, 0, 5, 32)


@pytest.mark.parametrize(
    ("name", "head", "file_bytes", "says"),
    [
        ("a.ply", b"GIF8", HUGE_BYTES, "starts with b'GIF8'"),
        ("a.glb", struct.pack("<4sIII4s", b"glTF", 2, 99, 5 << 20, b"JSON"), HUGE_BYTES, "of JSON"),
        ("a.glb", struct.pack("<4sIII4s", b"glTF", 2, 99, 80, b"JSON"), 99, "80 bytes of JSON"),
        ("a.ply", b"ply\n", HUGE_BYTES, "no end_header"),
        ("a.ply", ply_head(9, "ascii"), HUGE_BYTES, "format 'ascii'"),
        ("a.ply", ply_head(MAX_GAUSSIANS + 1), HUGE_BYTES, "claims 16777217 Gaussians"),
        ("a.ply", ply_head(99_999_999), HUGE_BYTES, "claims 99999999 Gaussians"),
        ("a.ply", ply_head(9_999), HUGE_BYTES, "9999 Gaussians in a frame, at most 999"),
        ("a.ply", ply_head(999), 200_000, "ends after 200000 bytes"),
        ("a.ply", ply_head(9).replace(b"opacity", b"sureness"), HUGE_BYTES, "no property opacity"),
        ("a.ply", ply_head(9), MAX_FILE_BYTES + 1, "longer than"),
        ("a.splat", b"", HUGE_BYTES, "claims 125000000 Gaussians"),
        ("a.splat", b"", HUGE_BYTES + 1, "not a whole number of records"),
        ("a.spz", spz_head(9, 5), HUGE_BYTES, "version 5"),
        ("a.spz", spz_head(MAX_GAUSSIANS + 1), HUGE_BYTES, "claims 16777217 Gaussians"),
        ("a.spz", spz_head(9_999), HUGE_BYTES, "at most 999"),
        ("a.spz", gzip.compress(spz_head(9_999, 3)), HUGE_BYTES, "at most 999"),
        ("a.spz", b"\x1f\x8bno", HUGE_BYTES, "SPZ: "),
    ],
)
def test_a_huge_file(name: str, head: bytes, file_bytes: int, says: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_bytes(head)
    os.truncate(path, file_bytes)
    with within_bytes(1 << 20), pytest.raises(CodecError, match=rf"a\.\w+:? .*{says}"):
        read_splats(path, 999)
