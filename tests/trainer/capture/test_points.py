"""Initial points: the variants of .ply that programs write, hostile bytes, and evenness."""

from __future__ import annotations

import contextlib
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import ArrayLike

from codec.camera import Camera
from tests.support.hostile import flips, refused, truncations, within_bytes
from trainer.capture import points as module
from trainer.capture.capture import InitialPoints
from trainer.capture.points import MAX_PLY_POINTS, points_evenness, read_ply, read_points_file
from trainer.errors import CaptureError

XYZ = ((0.5, -1.0, 0.25), (0.0, -0.5, 0.0), (-0.25, -1.5, 1.0))
RGB = ((255, 0, 7), (1, 2, 3), (40, 200, 90))
ROW = np.dtype([("alpha", "u1"), ("rgb", "u1", 3), ("xyz", "<f8", 3), ("n", "<i2")])


def header(
    layout: str, newline: str = "\n", version: str = " 1.0", count: int = 3, faces: bool = True
) -> bytes:
    lines = ["ply", f"format {layout}{version}", "comment by hand", f"element vertex {count}"]
    lines += [f"property uchar {name}" for name in ("alpha", "red", "green", "blue")]
    lines += [f"property double {name}" for name in "xyz"] + ["property short n"]
    if faces:
        lines += ["element face 1", "property list uchar int vertex_indices"]
    return newline.join([*lines, "end_header", ""]).encode()


def binary() -> bytes:
    rows = np.zeros(3, ROW)
    rows["rgb"], rows["xyz"] = RGB, XYZ
    return rows.tobytes()


def text() -> bytes:
    rows = [(9, *rgb, *xyz, -3) for rgb, xyz in zip(RGB, XYZ, strict=True)]
    return "\n".join(" ".join(map(str, row)) for row in rows).encode()


WHOLE = {
    "ascii": header("ascii") + text() + b"\n3 0 1 2\n",
    "binary": header("binary_little_endian") + binary() + bytes(13),
}


def accepts(path: Path, data: bytes) -> bool:
    """Whether `data` are points. Raises every error except CaptureError."""
    path.write_bytes(data)
    with contextlib.suppress(CaptureError):
        read_ply(path)
        return True
    return False


@pytest.mark.parametrize("faces", [True, False])
@pytest.mark.parametrize("version", [" 1.0", ""])
@pytest.mark.parametrize("newline", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("layout", ["ascii", "binary_little_endian"])
def test_any_flavour(layout: str, newline: str, version: str, faces: bool, tmp_path: Path) -> None:
    body = text() if layout == "ascii" else binary()
    path = tmp_path / "points.ply"
    path.write_bytes(header(layout, newline, version, faces=faces) + body)
    points = read_ply(path)
    assert np.array_equal(points.xyz, np.array(XYZ, np.float32))
    assert np.array_equal(points.rgb, RGB)


def test_text_is_the_same_in_any_blocks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "points.ply"
    path.write_bytes(WHOLE["ascii"])
    for block_bytes in (7, 8, 40):
        monkeypatch.setattr(module, "TEXT_BLOCK_BYTES", block_bytes)
        assert np.array_equal(read_ply(path).xyz, np.array(XYZ, np.float32))


@pytest.mark.parametrize("layout", WHOLE)
def test_any_bytes_give_points_or_one_clear_error(layout: str, tmp_path: Path) -> None:
    data, path = WHOLE[layout], tmp_path / "points.ply"
    assert accepts(path, data)
    needed = len(data) - len(b"\n3 0 1 2\n") - 2 if layout == "ascii" else len(data) - 13
    for part in truncations(data[:needed]):
        assert not accepts(path, part)
    for part in flips(data):
        accepts(path, part)


def test_what_is_not_a_coordinate_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "points.ply"
    for word in (b"one", b"nan", b"inf", b"1e300", b"\xff", b"0x1"):
        assert not accepts(path, WHOLE["ascii"].replace(b"0.25 ", word + b" ", 1))
    nan = np.zeros(3, ROW)
    nan["xyz"] = np.nan
    assert not accepts(path, header("binary_little_endian") + nan.tobytes())


def test_a_header_without_points_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "points.ply"
    for before, after, says in (
        (b"element vertex", b"element edge", "not a list of vertices"),
        (b"uchar red", b"float red", "red, green, blue as uchar"),
        (b" z\n", b" w\n", "lack x, y, z"),
        (b"short n", b"list int n", "not a list of vertices"),
    ):
        path.write_bytes(WHOLE["binary"].replace(before, after))
        refused(CaptureError, rf"points\.ply: .*{says}", read_ply, path)


@pytest.mark.parametrize(
    ("data", "is_sparse", "says"),
    [
        (header("ascii", count=MAX_PLY_POINTS), False, "does not hold the 67108864 vertices"),
        (header("binary_little_endian", count=MAX_PLY_POINTS), False, "ends after"),
        (header("ascii", count=MAX_PLY_POINTS + 1), False, "67108864 at most"),
        (b"ply\n", True, "no end_header"),
        (header("binary_big_endian"), True, "format binary_big_endian; write it as"),
        (header("ascii"), True, "does not hold the 3 vertices"),
        (header("binary_little_endian", count=1 << 40), True, "not a list of vertices"),
    ],
)
def test_false_claims_are_cheap(data: bytes, is_sparse: bool, says: str, tmp_path: Path) -> None:
    path = tmp_path / "points.ply"
    path.write_bytes(data)
    if is_sparse:
        os.truncate(path, 4 << 30)
    with within_bytes(8 << 20), pytest.raises(CaptureError, match=rf"points\.ply: .*{says}"):
        read_ply(path)


def write_ply(path: Path, xyz: ArrayLike, rgb: ArrayLike) -> None:
    """As text, with colours and nothing else."""
    places, colours = np.asarray(xyz).tolist(), np.asarray(rgb).tolist()
    names = [f"property float {n}" for n in "xyz"]
    names += [f"property uchar {n}" for n in ("red", "green", "blue")]
    head = ["ply", "format ascii 1.0", f"element vertex {len(places)}", *names, "end_header"]
    rows = [" ".join(map(str, [*p, *c])) for p, c in zip(places, colours, strict=True)]
    path.write_text("\n".join([*head, *rows, ""]))


def test_points_come_from_a_ply_as_from_an_npz(tmp_path: Path) -> None:
    xyz = np.array([[0.5, -1, 2], [3, 0.25, -4]], np.float32)
    rgb = np.array([[255, 0, 7], [1, 2, 3]], np.uint8)
    np.savez(tmp_path / "points.npz", xyz=xyz, rgb=rgb)
    write_ply(tmp_path / "points.PLY", xyz, rgb)
    for name in ("points.npz", "points.PLY"):
        points = read_points_file(tmp_path / name)
        np.testing.assert_array_equal(points.xyz, xyz)
        np.testing.assert_array_equal(points.rgb, rgb)
    with pytest.raises(CaptureError, match=r"points.txt: .*\.ply or an \.npz"):
        read_points_file(tmp_path / "points.txt")
    for name in ("pipe.ply", "pipe.npz"):
        os.mkfifo(tmp_path / name)
        refused(CaptureError, "not a regular file", read_points_file, tmp_path / name)


def test_evenness_is_the_share_of_the_picture_that_points_fill() -> None:
    camera = Camera("c", 160, 80, 100.0, 100.0, 80.0, 40.0, np.eye(4))
    v, u = np.mgrid[0:80, 0:160] + 0.5

    def points(columns: slice) -> InitialPoints:
        local = [(u - 80) / 100, (v - 40) / 100, np.ones_like(u)]
        xyz = 3 * np.stack(local, axis=-1)[:, columns].reshape(-1, 3)
        return InitialPoints(xyz.astype(np.float32), np.zeros((len(xyz), 3), np.uint8))

    assert points_evenness(points(slice(None)), [camera]) == pytest.approx(1)
    assert points_evenness(points(slice(0, 40)), [camera]) == pytest.approx(0.25)
    away = replace(camera, w2c=np.diag([1.0, -1, -1, 1]))
    assert points_evenness(points(slice(None)), [camera, away]) == pytest.approx(0.5)


def test_points_that_unpack_to_gigabytes_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "points.npz"
    np.savez_compressed(path, xyz=np.zeros((4_000_000, 3)), rgb=np.zeros((4_000_000, 3), np.uint8))
    assert path.stat().st_size < 1 << 20
    told = r"bytes that claim to be \d+ bytes of points"
    with within_bytes(1 << 22), pytest.raises(CaptureError, match=told):
        read_points_file(path)
    np.savez(path, xyz=np.ones((10, 3)), rgb=np.ones((10, 3)))
    # A header that claims more than there is; the checksum of the zip does not match either.
    path.write_bytes(path.read_bytes().replace(b"(10, 3), }      ", b"(99999999999, 3)"))
    refused(CaptureError, r"points\.npz: not an \.npz file of points", read_points_file, path)
