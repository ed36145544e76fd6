"""Files of Gaussians by name and first bytes, and frames of streams as files."""

from __future__ import annotations

import gzip
import os
import struct
from pathlib import Path

import numpy as np
import pytest

from codec.errors import CodecError, CorruptError, InvalidError, UnsupportedError
from codec.foreign.bounds import MAX_GAUSSIANS
from codec.foreign.spz import SpzVersion
from codec.interop.formats import (
    MAX_FILE_BYTES,
    SplatFormat,
    decode_any,
    encode_splats,
    export_stream,
    numbered,
    read_splats,
    write_splats,
)
from codec.sequence.survey import find_files
from codec.splats import Splats
from codec.stream import StreamReader
from tests.goldens.decoder import Gaussian, to_floats
from tests.goldens.folder import StreamFolder, state_at
from tests.support.drawn import same_splats
from tests.support.hostile import refused, survives, truncations, within_bytes
from tests.support.slots.folder import write_slots
from tests.support.slots.updates import small_layout
from tests.support.tiny_stream import write_tiny
from tests.support.trained_like import trained_like_splats


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
    refused(CorruptError, r"model\.ply is missing$", read_splats, path)
    refused(CorruptError, "cannot be read: Is a directory", read_splats, tmp_path)
    path.write_bytes(b"GIF89a and so on")
    refused(UnsupportedError, r"model\.ply: starts with b'GIF8'; this program", read_splats, path)
    for format in SplatFormat:
        path = tmp_path / f"empty.{format}"
        path.touch()
        if format is SplatFormat.SPLAT:  # without a header, an empty file has no Gaussians
            assert len(read_splats(path)) == 0
            continue
        refused(CorruptError, rf"empty\.{format}: is empty; this program reads", read_splats, path)
    # The first bytes count more than a wrong name.
    splats = trained_like_splats(5)
    write_splats(tmp_path / "model.spz", splats, SplatFormat.PLY)
    assert same_splats(read_splats(tmp_path / "model.spz"), splats)


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
        ("a.ply", ply_head(9, "ascii"), HUGE_BYTES, "format 'ascii'"),
        ("a.ply", ply_head(MAX_GAUSSIANS + 1), HUGE_BYTES, "claims 16777217 Gaussians"),
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


LAYOUT = small_layout(3, (9, 6), 1, 4)


@pytest.fixture(scope="module")
def stream(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six frames, three slices of forty Gaussians in each, two layers."""
    path = tmp_path_factory.mktemp("export") / "stream"
    write_tiny(path, 6)
    return path


def by_position(splats: Splats) -> Splats:
    return splats.take(np.lexsort(splats.means.T))


@pytest.mark.parametrize("layers", [1, 2])
def test_what_shows_is_exported_and_nothing_else(layers: int, tmp_path: Path) -> None:
    """Compared with the plain decoder: Gaussians that have started, and no empty slot."""
    write_slots(tmp_path / "s", 10, LAYOUT)
    hidden = 0
    for frame in range(10):
        shape = StreamFolder(tmp_path / "s").shape
        held = [
            (slot, lattice)
            for lane in state_at(tmp_path / "s", frame, layers)
            for row, lattice in zip(lane[:layers], shape.lattice[:layers], strict=True)
            for slot in row
        ]
        shown = [
            to_floats(slot, lattice)
            for slot, lattice in held
            if isinstance(slot, Gaussian) and slot.start <= frame
        ]
        hidden += len(held) - len(shown)
        means = np.array([floats.mean for floats in shown], np.float32).reshape(-1, 3)
        for format in SplatFormat if frame % 5 == 0 else (SplatFormat.PLY,):
            [out] = export_stream(tmp_path / "s", tmp_path / "o", frame, None, format, layers)
            found = read_splats(out.rename(f"{out}.{format}"))
            assert len(found) == len(shown)
            if format is SplatFormat.PLY:
                assert (by_position(found).means == means[np.lexsort(means.T)]).all()
                assert np.isfinite(found.logit_opacities).all()
    assert hidden > 20


def test_a_range_becomes_a_numbered_sequence(stream: Path, tmp_path: Path) -> None:
    written = export_stream(stream, tmp_path / "seq" / "tiny.ply", None, "2:5", None, None)
    assert [path.name for path in written] == ["tiny_0002.ply", "tiny_0003.ply", "tiny_0004.ply"]
    for frame, path in zip(range(2, 5), written, strict=True):
        assert same_splats(read_splats(path), StreamReader(stream).active_splats(frame, 2))
    assert find_files(tmp_path / "seq") == written  # import accepts exactly these files
    assert numbered(Path("a/b.v1"), 7, SplatFormat.SPZ) == Path("a/b.v1_0007.spz")
    assert numbered(Path("a/b.SPZ"), 12345, SplatFormat.SPZ) == Path("a/b_12345.spz")


@pytest.mark.parametrize(
    ("frame", "frames", "name", "layers", "says"),
    [
        (None, None, "a.ply", None, "either --frame F or --frames A:B"),
        (1, "1:2", "a.ply", None, "either --frame F or --frames A:B"),
        (6, None, "a.ply", None, "no frame 6; it has 6 frames"),
        (None, "4:4", "a.ply", None, "hold no frame"),
        (None, "6:", "a.ply", None, "has frames 0:6"),
        (None, "4", "a.ply", None, "not FIRST:END"),
        (0, None, "a.obj", None, "no known suffix; give --format, one of ply, splat, spz, sog"),
        (0, None, "a.ply", 0, "0 layers of 2"),
        (0, None, "file/a.ply", None, r"file/a\.ply cannot be written: "),
    ],
)
def test_a_bad_export_is_refused_with_the_reason(
    stream: Path,
    tmp_path: Path,
    frame: int | None,
    frames: str | None,
    name: str,
    layers: int | None,
    says: str,
) -> None:
    (tmp_path / "file").write_text("no folder")
    refused(InvalidError, says, export_stream, stream, tmp_path / name, frame, frames, None, layers)
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


@pytest.mark.parametrize(
    ("format", "version"),
    [(f, None) for f in SplatFormat if f not in ("splat", "spz")]
    + [(SplatFormat.SPZ, version) for version in SpzVersion],
)
def test_no_part_of_a_file_is_a_file(format: SplatFormat, version: SpzVersion | None) -> None:
    data = encode_splats(trained_like_splats(2, sh_degree=1), format, version)
    parts = list(truncations(data))[:: 1 if len(data) < 1000 else 37]
    assert not [len(part) for part in parts if survives(decode_any, part)]
