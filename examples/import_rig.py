"""An OpenCV calibration as a capture: writes the transforms.json that swings-train reads.

    python examples/import_rig.py rig.toml my-capture --unit mm
    swings-train my-capture --check rig.png

my-capture/videos holds a video for each camera, named like the camera: cam1.mp4 for cam1.

rig.toml is what caliscope, Pose2Sim and anipose write (Pose2Sim also makes it of Qualisys and Vicon
files), or the same as JSON. A table for each camera:

    [cam1]
    size = [1920, 1080]                          pixels
    matrix = [[1400, 0, 960], [0, 1400, 540], [0, 0, 1]]
    distortions = [-0.1, 0.02, 0.0, 0.0]         k1, k2, p1, p2 and maybe k3; may be left out
    rotation = [0.1, 2.0, 0.0]                   rvec, or the 3x3 matrix: world to camera
    translation = [0.0, 1000.0, 4000.0]          tvec, in the unit of --unit
    name = "cam1"                                may be left out
"""

from __future__ import annotations

import argparse
import json
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

Doubles = npt.NDArray[np.float64]

METRES = {"m": 1.0, "cm": 0.01, "mm": 0.001}
VIDEO_SUFFIXES = (".mp4", ".mov", ".mkv", ".webm", ".avi")
OPENGL_FROM_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])
"""OpenCV's cameras have y down and z forward, nerfstudio's y up and z backwards."""


def rotation_matrix(rotation: Doubles) -> Doubles:
    """(3, 3) of a rotation vector (3,), whose length is the angle in radians, or of a matrix."""
    if rotation.shape == (3, 3):
        return rotation
    angle_rad = float(np.linalg.norm(rotation))
    if angle_rad == 0:
        return np.eye(3)
    x, y, z = rotation.ravel() / angle_rad
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    turned: Doubles = (
        np.eye(3) + np.sin(angle_rad) * cross + (1 - np.cos(angle_rad)) * cross @ cross
    )
    return turned


def entry_of(name: str, camera: dict[str, Any], video: str, metres: float) -> dict[str, Any]:
    """The entry of `frames` for one camera."""
    if camera.get("fisheye"):
        raise SystemExit(f"{name}: fisheye lenses are not read; undistort the videos first")
    (fx, skew, cx), (_, fy, cy), _ = camera["matrix"]
    given: list[float] = camera.get("distortions", [])
    k1, k2, p1, p2, k3, *more = given + [0.0] * (5 - len(given))
    if any(more) or skew:
        raise SystemExit(f"{name}: a skew, or more than k1, k2, p1, p2, k3, is not read")
    world_to_camera = np.eye(4)
    world_to_camera[:3, :3] = rotation_matrix(np.array(camera["rotation"], np.float64))
    world_to_camera[:3, 3] = metres * np.array(camera["translation"], np.float64).ravel()
    pose = np.linalg.inv(world_to_camera) @ OPENGL_FROM_OPENCV
    width, height = map(int, camera["size"])
    return {
        "file_path": video,
        "transform_matrix": pose.tolist(),
        "w": width,
        "h": height,
        "fl_x": fx,
        "fl_y": fy,
        # OpenCV counts from the middle of the first pixel, nerfstudio from its corner.
        "cx": cx + 0.5,
        "cy": cy + 0.5,
        **{"k1": k1, "k2": k2, "k3": k3, "p1": p1, "p2": p2},
    }


def read_calibration(path: Path) -> dict[str, dict[str, Any]]:
    """The tables of the cameras, by the cameras' names."""
    text = path.read_text(encoding="utf-8")
    tables = json.loads(text) if path.suffix == ".json" else tomllib.loads(text)
    return {
        str(table.get("name", key)): table
        for key, table in tables.items()
        if isinstance(table, dict) and "matrix" in table  # such as [metadata] is not a camera
    }


def main() -> None:
    parser = argparse.ArgumentParser(description="Writes transforms.json for a calibrated rig.")
    parser.add_argument("calibration", type=Path, help=".toml or .json, see the head of this file")
    parser.add_argument("capture", type=Path, help="folder to write transforms.json to")
    parser.add_argument("--videos", default="videos", help="folder of the videos, in the capture's")
    parser.add_argument("--unit", default="m", choices=METRES, help="unit of the translations")
    args = parser.parse_args()
    cameras = read_calibration(args.calibration)
    videos = {
        path.stem: path.relative_to(args.capture).as_posix()
        for path in sorted((args.capture / args.videos).iterdir())
        if path.suffix.lower() in VIDEO_SUFFIXES
    }
    if not cameras or cameras.keys() != videos.keys():
        raise SystemExit(
            f"cameras {sorted(cameras)} and videos {sorted(videos)} must have the same names"
        )
    frames = [
        entry_of(name, camera, videos[name], METRES[args.unit]) for name, camera in cameras.items()
    ]
    (args.capture / "transforms.json").write_text(
        json.dumps({"camera_model": "OPENCV", "frames": frames}, indent=1), encoding="utf-8"
    )


if __name__ == "__main__":
    main()
