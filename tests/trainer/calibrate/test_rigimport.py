"""swings-capture import reads calibrated cameras from files of OpenCV and COLMAP."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from codec.camera import Camera
from tests.support.commands import run, run_ok
from tests.support.tiny_capture import tiny_rig
from tests.support.tiny_models import write_model, write_videos
from trainer.capture.layout import open_capture

LENS = [-0.02, 0.003, 0.001, -0.002]


def calibration_of(cameras: list[Camera]) -> dict[str, dict[str, Any]]:
    """A calibration in the form of caliscope: millimetres, the first pixel's middle at 0, 0."""
    tables = {}
    for number, camera in enumerate(cameras):
        matrix = np.diag([camera.fx_px, camera.fy_px, 1.0])
        matrix[:2, 2] = camera.cx_px - 0.5, camera.cy_px - 0.5
        tables[f"cam_{number}"] = {
            "name": camera.name,
            "size": [camera.width_px, camera.height_px],
            "matrix": matrix.tolist(),
            "distortions": LENS,
            "rotation": Rotation.from_matrix(camera.w2c[:3, :3]).as_rotvec().tolist(),
            "translation": (1000 * camera.w2c[:3, 3]).tolist(),
        }
    return tables


def as_toml(tables: dict[str, dict[str, Any]]) -> str:
    lines = []
    for name, table in tables.items():
        lines += [f"[{name}]", *(f"{key} = {json.dumps(value)}" for key, value in table.items())]
    return "\n".join([*lines, "[metadata]", "adjusted = true", ""])


def assert_cameras(root: Path, cameras: list[Camera]) -> None:
    for entry, camera in zip(open_capture(root).cameras, cameras, strict=True):
        assert entry.camera.name == camera.name
        np.testing.assert_allclose(entry.camera.w2c, camera.w2c, atol=1e-9)
        np.testing.assert_allclose(entry.camera.intrinsics, camera.intrinsics, atol=1e-9)


def test_a_calibrated_rig_becomes_a_capture(tmp_path: Path) -> None:
    """docs/CAPTURES.md has one in JSON, with matrices, and a model in text."""
    root, rig = tmp_path / "c", tmp_path / "rig.toml"
    write_videos(root, cameras := tiny_rig(3), 3)
    rig.write_text(as_toml(calibration_of(cameras)))
    (root / "videos/._cam00.mp4").write_bytes(b"what macOS leaves on foreign disks")
    told = run_ok("swings-capture", "import", rig, root, "--unit", "mm")
    assert told == f"{root}: 3 cameras, 3 frames\n"
    assert open_capture(root).num_frames == 3
    assert_cameras(root, cameras)
    frames = json.loads((root / "transforms.json").read_text())["frames"]
    assert [frames[0][key] for key in ("k1", "k2", "p1", "p2", "k3")] == [*LENS, 0]


def test_a_model_of_the_first_frames_becomes_a_capture(tmp_path: Path) -> None:
    root, model = tmp_path / "c", tmp_path / "sparse"
    write_videos(root, cameras := tiny_rig(4), 2)
    write_model(model, cameras, [f"{c.name}.png" for c in cameras], True, "OPENCV", LENS)
    run_ok("swings-capture", "import", model, root)
    assert_cameras(root, cameras)
    again = run("swings-capture", "import", model, root)
    assert "transforms.json exists; remove it first" in again.stderr


def test_what_cannot_be_imported_is_one_line(tmp_path: Path) -> None:
    root, rig = tmp_path / "c", tmp_path / "rig.json"
    write_videos(root, cameras := tiny_rig(2), 1)
    (intri := tmp_path / "intri.yml").write_text("%YAML:1.0\n")
    done = run("swings-capture", "import", intri, root)
    assert f"opens as it is: swings-train {tmp_path} STREAM" in done.stderr
    for change, message in (
        ({"name": "elsewhere"}, "give both the same names"),
        ({"size": [64]}, "size is not numbers of the expected shape"),
        ({"rotation": [1, 2]}, "rotation is neither rvec nor a 3x3 matrix"),
        ({"translation": [0, "x", 1]}, "translation is not numbers"),
        ({"translation": [0, float("nan"), 1]}, "not finite"),
        ({"size": [64, 20]}, "is 64x36 px"),
        ({"fisheye": True}, "fisheye lenses are not read"),
        ({"distortions": [0, 0, 0, 0, 0, 0.1]}, "more than k1, k2, p1, p2, k3"),
    ):
        tables = calibration_of(cameras)
        tables["cam_1"] |= change
        rig.write_text(json.dumps(tables))
        done = run("swings-capture", "import", rig, root)
        assert (done.returncode, done.stderr.count("\n")) == (1, 1), done.stderr
        assert message in done.stderr
        assert not (root / "transforms.json").exists()
