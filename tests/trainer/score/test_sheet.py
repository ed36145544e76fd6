"""The contact sheet shows each of its pictures completely, for any sizes."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image

from codec.camera import Camera
from tests.support.tiny_capture import tiny_rig
from tests.support.tiny_stream import tiny_manifest, write_tiny
from trainer.capture.layout import open_capture
from trainer.score.sheet import HEADER_PX, write_sheet

SIZES = ((64, 36), (20, 50), (90, 30))


def test_cameras_of_any_size_are_whole(tmp_path: Path) -> None:
    """A portrait camera and a wide one among others: the first row does not define the others."""
    root, frames = tmp_path / "capture", 6
    cameras = [resized(c, *SIZES[i % 3]) for i, c in enumerate(tiny_rig(6))]
    write_capture(root, cameras, frames)
    manifest = replace(tiny_manifest(), cameras=tuple(cameras), default_camera=cameras[0].name)
    write_tiny(tmp_path / "stream", frames, manifest)
    held_out = [cameras[i] for i in open_capture(root).held_out]
    assert [(c.width_px, c.height_px) for c in held_out] == [*SIZES]
    write_sheet(tmp_path / "stream", root, tmp_path / "sheet.png")
    with Image.open(tmp_path / "sheet.png") as image:
        sheet = np.asarray(image)
    rows = [held_out[row % 3] for row in range(6)]
    assert sheet.shape == (
        sum(c.height_px + HEADER_PX for c in rows), max(3 * c.width_px for c in rows), 3
    )  # fmt: skip
    top = 0
    for row, camera in enumerate(rows):
        top += HEADER_PX
        line = sheet[top : top + camera.height_px]
        captured = line[:, : camera.width_px]
        assert (captured == colour_of(cameras.index(camera), row)).all()
        error = line[:, 2 * camera.width_px : 3 * camera.width_px]
        assert error.max() > 0  # the third column is there to its last pixel
        assert error[:, -1].max() > 0
        assert line[:, 3 * camera.width_px :].max(initial=0) == 0
        top += camera.height_px


def resized(camera: Camera, width_px: int, height_px: int) -> Camera:
    return replace(
        camera, width_px=width_px, height_px=height_px, cx_px=width_px / 2, cy_px=height_px / 2
    )


def colour_of(camera: int, frame: int) -> tuple[int, int, int]:
    return 90 + 20 * camera, 100 + 5 * frame, 200


def write_capture(root: Path, cameras: list[Camera], num_frames: int) -> None:
    """Writes a capture in the nerfstudio layout, in which each camera may have its own size."""
    entries = []
    for index, camera in enumerate(cameras):
        pose = np.linalg.inv(camera.w2c) @ np.diag([1.0, -1.0, -1.0, 1.0])
        (root / "images" / camera.name).mkdir(parents=True)
        size = (camera.height_px, camera.width_px, 3)
        for frame in range(num_frames):
            name = f"images/{camera.name}/{frame:06d}.png"
            Image.fromarray(np.full(size, colour_of(index, frame), np.uint8)).save(root / name)
            entries.append({
                "file_path": name, "transform_matrix": pose.tolist(), "fl_x": camera.fx_px,
                "fl_y": camera.fy_px, "cx": camera.cx_px, "cy": camera.cy_px,
                "w": camera.width_px, "h": camera.height_px,
            })  # fmt: skip
    (root / "transforms.json").write_text(json.dumps({"frames": entries}))
    (root / "held_out.txt").write_text("".join(f"{c.name}\n" for c in cameras[:3]))
