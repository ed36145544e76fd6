"""Tiny COLMAP models and Nerfstudio transforms, written independently of the readers."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from scipy.spatial.transform import Rotation

from codec.arrays import Bytes, Doubles
from codec.camera import Camera
from tests.support.tiny_capture import picture_of, tiny_rig, write_video

MODEL_NUMBERS = {"SIMPLE_PINHOLE": 0, "PINHOLE": 1, "SIMPLE_RADIAL": 2, "RADIAL": 3, "OPENCV": 4}
MODEL_NUMBERS |= {"OPENCV_FISHEYE": 5}
POINTS = ((0.5, -1.0, 0.25), (0.0, -0.5, 0.0), (-0.25, -1.5, 1.0))
COLOURS = ((255, 0, 7), (1, 2, 3), (40, 200, 90))

Picturer = Callable[[int, int], Bytes]


def quaternion_of(rotation: Doubles) -> tuple[float, ...]:
    """(w, x, y, z)."""
    x, y, z, w = Rotation.from_matrix(rotation).as_quat().tolist()
    return w, x, y, z


def write_easymocap(root: Path, num_cameras: int, num_frames: int) -> list[Camera]:
    """Pictures, intri.yml, and extri.yml with rotation vectors."""
    cameras = tiny_rig(num_cameras)
    write_pictures(root, cameras, num_frames, False)
    files = {"intri.yml": "%YAML:1.0\n---\nnames:\n", "extri.yml": "%YAML:1.0\n---\nnames:\n"}
    for camera in cameras:
        k = [camera.fx_px, 0, camera.cx_px - 0.5, 0, camera.fy_px, camera.cy_px - 0.5, 0, 0, 1]
        for file, name, rows, columns, numbers in (
            ("intri.yml", "K", 3, 3, k),
            ("intri.yml", "dist", 1, 5, [0.0] * 5),
            ("extri.yml", "R", 3, 1, Rotation.from_matrix(camera.w2c[:3, :3]).as_rotvec().tolist()),
            ("extri.yml", "T", 3, 1, camera.w2c[:3, 3].tolist()),
        ):
            files[file] += (
                f"{name}_{camera.name}: !!opencv-matrix\n   rows: {rows}\n   cols: {columns}\n"
                f"   dt: d\n   data: [ {', '.join(map(str, numbers))} ]\n"
            )
    for file, text in files.items():
        (root / file).write_text(text)
    return cameras


def parameters_of(camera: Camera, model: str, distortion: Sequence[float]) -> tuple[float, ...]:
    single = model in ("SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL")
    focal = (camera.fx_px,) if single else (camera.fx_px, camera.fy_px)
    return (*focal, camera.cx_px, camera.cy_px, *distortion)


def write_model(
    folder: Path,
    cameras: Sequence[Camera],
    names: Sequence[str],
    binary: bool,
    model: str = "PINHOLE",
    distortion: Sequence[float] = (),
) -> None:
    """Writes one COLMAP camera and one image per camera, and three points."""
    folder.mkdir(parents=True)
    rows = [
        (number, camera, name, quaternion_of(camera.w2c[:3, :3]), camera.w2c[:3, 3].tolist())
        for number, (camera, name) in enumerate(zip(cameras, names, strict=True), 1)
    ]
    if binary:
        optics = images = struct.pack("<Q", len(cameras))
        points = struct.pack("<Q", len(POINTS))
        for number, camera, name, quaternion, translation in rows:
            parameters = parameters_of(camera, model, distortion)
            optics += struct.pack(
                "<iiQQ", number, MODEL_NUMBERS[model], camera.width_px, camera.height_px
            ) + struct.pack(f"<{len(parameters)}d", *parameters)
            images += struct.pack("<i7di", 9 + number, *quaternion, *translation, number)
            images += name.encode() + b"\0" + struct.pack("<Q", 1)
            images += struct.pack("<ddq", 1.5, 2.5, -1)
        for number, (xyz, rgb) in enumerate(zip(POINTS, COLOURS, strict=True)):
            points += struct.pack("<Q3d3Bd", number, *xyz, *rgb, 0.5)
            points += struct.pack("<Qiiii", 2, 10, 0, 11, 0)
        (folder / "cameras.bin").write_bytes(optics)
        (folder / "images.bin").write_bytes(images)
        (folder / "points3D.bin").write_bytes(points)
        return
    text = ["# Camera list", f"# Number of cameras: {len(cameras)}"]
    poses = ["# Image list", f"# Number of images: {len(cameras)}, mean observations: 0.5"]
    for number, camera, name, quaternion, translation in rows:
        numbers = " ".join(map(repr, parameters_of(camera, model, distortion)))
        text.append(f"{number} {model} {camera.width_px} {camera.height_px} {numbers}")
        pose = " ".join(map(repr, (*quaternion, *translation)))
        poses += [f"{9 + number} {pose} {number} {name}", "1.5 2.5 -1" if number % 2 else ""]
    (folder / "cameras.txt").write_text("\n".join(text) + "\n")
    (folder / "images.txt").write_text("\n".join(poses) + "\n")
    marks = ["# 3D point list", f"# Number of points: {len(POINTS)}, mean track length: 2"]
    for number, (xyz, rgb) in enumerate(zip(POINTS, COLOURS, strict=True)):
        marks.append(" ".join(map(str, (number, *xyz, *rgb, 0.5, 10, 0, 11, 0))))
    (folder / "points3D.txt").write_text("\n".join(marks) + "\n")


def write_pictures(
    root: Path,
    cameras: Sequence[Camera],
    num_frames: int,
    by_frame: bool,
    picture: Picturer = picture_of,
) -> list[list[str]]:
    """Writes the pictures as frames/frame_N/cam.png or images/cam/N.png, from number 7 on.

    Returns their paths below root, by camera and frame.
    """
    paths = []
    for index, camera in enumerate(cameras):
        paths.append(
            [
                f"frames/frame_{7 + frame:02d}/{camera.name}.png"
                if by_frame
                else f"images/{camera.name}/{7 + frame:04d}.png"
                for frame in range(num_frames)
            ]
        )
        for frame, path in enumerate(paths[-1]):
            (root / path).parent.mkdir(parents=True, exist_ok=True)
            Image.fromarray(picture(index, frame)).save(root / path)
    return paths


def transforms_of(cameras: Sequence[Camera], paths: Sequence[Sequence[str]]) -> dict[str, Any]:
    """A transforms.json; the intrinsics at the top are those of the first camera."""
    first = cameras[0]
    frames = []
    for camera, of_camera in zip(cameras, paths, strict=True):
        pose = np.linalg.inv(camera.w2c) @ np.diag([1.0, -1.0, -1.0, 1.0])
        for path in of_camera:
            entry = {"file_path": path, "transform_matrix": pose.tolist()}
            frames.append(entry | intrinsics_of(camera) if camera is not first else entry)
    return {"camera_model": "OPENCV", **intrinsics_of(first), "frames": frames}


def intrinsics_of(camera: Camera) -> dict[str, float]:
    return {
        "fl_x": camera.fx_px,
        "fl_y": camera.fy_px,
        "cx": camera.cx_px,
        "cy": camera.cy_px,
        "w": camera.width_px,
        "h": camera.height_px,
    }


def write_transforms(root: Path, value: dict[str, Any]) -> None:
    (root / "transforms.json").write_text(json.dumps(value))


def write_videos(root: Path, cameras: Sequence[Camera], num_frames: int) -> list[list[str]]:
    (root / "videos").mkdir(parents=True)
    for index, camera in enumerate(cameras):
        write_video(root / "videos" / f"{camera.name}.mp4", index, num_frames)
    return [[f"./videos/{camera.name}.mp4"] for camera in cameras]
