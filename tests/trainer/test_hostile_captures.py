"""Files of a capture may be pipes, or claim an enormous size: each gives one error line."""

from __future__ import annotations

import json
import os
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.support.commands import run
from tests.support.tiny_capture import tiny_rig, write_dynamic3dgs, write_dynerf
from tests.support.tiny_models import transforms_of, write_transforms, write_videos
from trainer.capture.dynerf import read_poses_bounds
from trainer.capture.layout import open_capture
from trainer.capture.points import read_points, read_points_file
from trainer.errors import CaptureError


def pipe_for_poses(root: Path) -> None:
    write_dynerf(root)
    replaced_by_a_pipe(root / "poses_bounds.npy")


def pipe_for_a_video(root: Path) -> None:
    write_dynerf(root)
    replaced_by_a_pipe(root / "cam01.mp4")


def pipe_for_a_picture(root: Path) -> None:
    write_dynamic3dgs(root)
    replaced_by_a_pipe(root / "ims" / "2" / "000000.png")


def pipe_for_transforms(root: Path) -> None:
    root.mkdir()
    replaced_by_a_pipe(root / "transforms.json")


def replaced_by_a_pipe(path: Path) -> None:
    path.unlink(missing_ok=True)
    os.mkfifo(path)


@pytest.mark.parametrize(
    "make", [pipe_for_poses, pipe_for_a_video, pipe_for_a_picture, pipe_for_transforms]
)
def test_nobody_waits_for_the_other_end_of_a_pipe(
    make: Callable[[Path], None], tmp_path: Path
) -> None:
    make(tmp_path / "capture")
    done = run("swings-train", tmp_path / "capture", tmp_path / "stream", timeout_s=60)
    assert done.returncode == 1
    assert len(done.stderr.splitlines()) == 1, done.stderr
    assert not (tmp_path / "stream").exists()


@pytest.mark.parametrize("name", ["points.ply", "points.npz"])
def test_points_are_not_read_from_a_pipe(name: str, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / name)
    with pytest.raises(CaptureError, match="not a regular file"):
        read_points_file(tmp_path / name)


def test_rows_that_a_header_only_claims_are_not_made(tmp_path: Path) -> None:
    path = tmp_path / "poses_bounds.npy"
    claim = {"descr": "<f8", "fortran_order": False, "shape": (10**11, 17)}
    with open(path, "wb") as file:
        np.lib.format.write_array_header_1_0(file, claim)
        file.write(bytes(24))
    with pytest.raises(CaptureError, match=r"poses_bounds\.npy"):
        read_poses_bounds(path)


def test_points_that_unpack_to_gigabytes_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "points.npz"
    np.savez_compressed(path, xyz=np.zeros((4_000_000, 3)), rgb=np.zeros((4_000_000, 3), np.uint8))
    assert path.stat().st_size < 1 << 20
    tracemalloc.start()
    try:
        with pytest.raises(CaptureError, match=r"bytes that claim to be \d+ bytes of points"):
            read_points(path)
        assert tracemalloc.get_traced_memory()[1] < 1 << 22
    finally:
        tracemalloc.stop()


def test_points_whose_header_claims_more_than_there_is(tmp_path: Path) -> None:
    path = tmp_path / "points.npz"
    np.savez(path, xyz=np.ones((10, 3)), rgb=np.ones((10, 3)))
    data = path.read_bytes()
    # The checksum of the zip does not match either; both are damage.
    path.write_bytes(data.replace(b"(10, 3), }      ", b"(99999999999, 3)"))
    with pytest.raises(CaptureError, match=r"points\.npz: not an \.npz file of points"):
        read_points(path)


def dynerf_of(root: Path, focal_px: float) -> None:
    write_dynerf(root, 4, 3)
    rows = np.load(root / "poses_bounds.npy")
    rows[1, 14] = focal_px
    np.save(root / "poses_bounds.npy", rows)


def dynamic3dgs_of(root: Path, focal_px: float) -> None:
    write_dynamic3dgs(root)
    path = root / "train_meta.json"
    meta = json.loads(path.read_text())
    for row in meta["k"]:
        row[0][0][0] = row[0][1][1] = focal_px
    path.write_text(json.dumps(meta))


def nerfstudio_of(root: Path, focal_px: float) -> None:
    cameras = tiny_rig(4)
    value = transforms_of(cameras, write_videos(root, cameras, 3))
    value["frames"][1] |= {"fl_x": focal_px, "fl_y": focal_px}
    write_transforms(root, value)


@pytest.mark.parametrize("focal_px", [1e-300, 1e-30, 1e300])
@pytest.mark.parametrize("make", [dynerf_of, dynamic3dgs_of, nerfstudio_of])
def test_a_focal_length_of_no_lens_is_refused(
    make: Callable[[Path, float], None], focal_px: float, tmp_path: Path
) -> None:
    make(tmp_path / "capture", focal_px)
    with pytest.raises(CaptureError, match="focal length"):
        open_capture(tmp_path / "capture")
