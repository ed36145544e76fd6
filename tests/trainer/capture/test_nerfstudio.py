"""The Nerfstudio layout: its forms of file_path, points, held-out cameras, refusals."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from codec.camera import Camera
from tests.support.tiny_capture import picture_of, refusal, tiny_rig
from tests.support.tiny_models import (
    COLOURS,
    POINTS,
    intrinsics_of,
    transforms_of,
    write_pictures,
    write_transforms,
    write_videos,
)
from tests.trainer.capture.test_points import write_ply
from trainer.capture.layout import open_capture
from trainer.capture.lens import Lens, straightened

NUM_FRAMES = 3
FORMS = ("frames", "images", "frames listed", "images listed", "times")


def write_nerfstudio(root: Path, form: str = "frames") -> list[Camera]:
    root.mkdir(exist_ok=True)
    cameras = tiny_rig(3)
    paths = write_pictures(root, cameras, NUM_FRAMES, form.startswith("frames"))
    if form == "times":
        (root / "all").mkdir()
        for of_camera in paths:
            for frame, path in enumerate(of_camera):
                of_camera[frame] = "all/" + path.replace("/", "_")
                (root / path).rename(root / of_camera[frame])
    is_listed = form not in ("frames", "images")
    value = transforms_of(cameras, paths if is_listed else [p[:1] for p in paths])
    if is_listed:
        for number, entry in enumerate(value["frames"]):
            entry["time"] = (number % NUM_FRAMES) / NUM_FRAMES
    write_transforms(root, value)
    return cameras


def edit(root: Path, change: Callable[[dict[str, Any]], object]) -> None:
    value = json.loads((root / "transforms.json").read_text())
    change(value)
    write_transforms(root, value)


@pytest.mark.parametrize("form", FORMS)
def test_pictures_as_written(tmp_path: Path, form: str) -> None:
    written = write_nerfstudio(tmp_path, form)
    capture = open_capture(tmp_path)
    assert (capture.layout, capture.num_frames, capture.fps) == ("nerfstudio", NUM_FRAMES, None)
    assert (capture.held_out, capture.points) == ((1,), None)
    for index, camera in enumerate(written):
        got = capture.cameras[index].camera
        assert got.name == camera.name
        assert np.allclose(got.w2c, camera.w2c, atol=1e-12)
        for frame in (2, 0):
            picture = capture.open_images(index).read(frame)
            assert np.array_equal(picture, picture_of(index, frame))


def test_distortion_is_taken_out_of_videos(tmp_path: Path) -> None:
    lens = Lens(k1=-0.1, k2=0.02, k3=0.001, p1=0.002, p2=-0.001)
    terms = {"k1": -0.1, "k2": 0.02, "k3": 0.001, "p1": 0.002, "p2": -0.001, "k4": 0.0}
    cameras = tiny_rig(3)
    paths = write_videos(tmp_path / "v", cameras, 2)
    write_transforms(tmp_path / "v", transforms_of(cameras, paths) | terms)
    source = open_capture(tmp_path / "v").open_images(1)
    expected = straightened(picture_of(1, 1), cameras[1], lens).astype(int)
    assert np.abs(source.read(1).astype(int) - expected).max() <= 3
    source.close()


def as_others_write(value: dict[str, Any]) -> None:
    """Blender's angles, no size, and the paths of Windows."""
    value["camera_angle_x"] = 2 * np.arctan(value["w"] / value["fl_x"] / 2)
    for entry in (value, *value["frames"]):
        for key in ("fl_x", "fl_y", "w", "h", "cx", "cy"):
            entry.pop(key, None)
    for entry in value["frames"]:
        entry["file_path"] = entry["file_path"].replace("/", "\\")


@pytest.mark.parametrize("form", ["frames", "images", "videos"])
def test_what_other_programs_write(form: str, tmp_path: Path) -> None:
    cameras = write_nerfstudio(tmp_path, form)
    if form == "videos":
        write_transforms(tmp_path, transforms_of(cameras, write_videos(tmp_path, cameras, 2)))
    if form == "images":
        for path in tmp_path.glob("images/*/*.png"):
            Image.open(path).save(path.with_suffix(".webp"), lossless=True)
            path.unlink()
        text = (tmp_path / "transforms.json").read_text()
        (tmp_path / "transforms.json").write_text(text.replace(".png", ".webp"))
    edit(tmp_path, as_others_write)
    capture = open_capture(tmp_path)
    for entry, camera in zip(capture.cameras, cameras, strict=True):
        assert entry.camera.name == camera.name
        np.testing.assert_allclose(entry.camera.intrinsics, camera.intrinsics)
    source = capture.open_images(1)
    assert np.abs(source.read(1).astype(int) - picture_of(1, 1)).max() <= 2
    source.close()


def test_held_out_cameras_and_rate(tmp_path: Path) -> None:
    write_nerfstudio(tmp_path, "images listed")
    names = [f"./images/cam01/{7 + frame:04d}.png" for frame in range(NUM_FRAMES)]
    edit(tmp_path, lambda v: v.update(test_filenames=names, fps=25))
    capture = open_capture(tmp_path)
    assert (capture.held_out, capture.fps) == ((1,), 25)
    edit(tmp_path, lambda v: v.update(test_filenames=names[:2]))
    assert "some frames of camera cam01, but not images/cam01/0009.png" in refusal(tmp_path)
    (tmp_path / "held_out.txt").write_text("cam02")
    assert open_capture(tmp_path).held_out == (2,)
    edit(tmp_path, lambda v: v.update(fps=None))
    assert open_capture(tmp_path).fps is None
    (tmp_path / "fps.txt").write_text("50")
    assert open_capture(tmp_path).fps == 50


def test_points_of_a_ply_file_or_of_an_npz_beside_it(tmp_path: Path) -> None:
    write_nerfstudio(tmp_path)
    edit(tmp_path, lambda v: v.update(ply_file_path="points.ply"))
    assert "points.ply is missing" in refusal(tmp_path)
    write_ply(tmp_path / "points.ply", POINTS, COLOURS)
    points = open_capture(tmp_path).points
    assert points is not None
    assert np.array_equal(points.xyz, np.array(POINTS, np.float32))
    assert np.array_equal(points.rgb, COLOURS)
    np.savez(tmp_path / "points.npz", xyz=np.ones((5, 3)), rgb=np.ones((5, 3)))
    points = open_capture(tmp_path).points
    assert points is not None
    assert len(points) == 5


def turn(entry: dict[str, Any]) -> None:
    entry["transform_matrix"][0][3] += 0.01


@pytest.mark.parametrize(
    ("form", "change", "said"),
    [
        ("frames", lambda v: v.pop("frames"), "`frames` is not a list"),
        ("frames", lambda v: v.update(frames=[{}]), "entry 0 of `frames` has no file_path"),
        ("frames", lambda v: v.pop("fl_x"), "lacks fl_x"),
        ("frames", lambda v: v.update(w=None, fl_x=None), "lacks fl_x"),
        ("frames", lambda v: v.update(fl_x=None, camera_angle_x=4), "camera_angle_x is 4"),
        ("frames", lambda v: v.update(cx="left"), "cx is 'left', not a number"),
        ("frames", lambda v: v.update(cx=10**400), "not a number"),
        ("frames", lambda v: v.update(cx=True), "cx is 'True', not a number"),
        ("frames", lambda v: v["frames"][1].update(transform_matrix=[[1e300] * 4] * 4), "over 1e9"),
        ("frames", lambda v: v["frames"][1].update(file_path="frames/1/a\nb.png"), "inside the"),
        ("frames", lambda v: v.update(w=64.5), "size 64.5x36 px is not whole"),
        ("frames", lambda v: v.update(w=65), "is 64x36 px"),
        ("frames", lambda v: v.update(camera_model="OPENCV_FISHEYE"), "OPENCV_FISHEYE is not"),
        ("frames", lambda v: v.update(is_fisheye=True), "(fisheye) is not read"),
        ("frames", lambda v: v.update(k4=0.1), "distortion by k4"),
        ("frames", lambda v: v.update(k1=-2), "of the picture over, from its"),
        ("frames", lambda v: v["frames"][1].pop("transform_matrix"), "is not a 4x4 matrix"),
        ("frames", lambda v: v["frames"][1].update(transform_matrix=[[1], [2, 3]]), "not a 4x4"),
        ("frames", lambda v: v["frames"][1].update(transform_matrix=[[2] * 4] * 4), "rotation"),
        ("frames", lambda v: v["frames"][1].update(file_path="..\\x.png"), "inside the capture"),
        ("frames", lambda v: v["frames"].append(v["frames"][0]), "listed twice"),
        ("frames", lambda v: v["frames"][1].update(file_path="a.mp4"), "some file_path are videos"),
        ("frames", lambda v: v["frames"][1].update(file_path="a.png"), "names neither a camera"),
        ("frames", lambda v: v["frames"][1].update(file_path="b/frames/1/a.png"), "use one folder"),
        ("frames", lambda v: v["frames"][1].update(fl_x=1e-300), "focal length"),
        ("frames", lambda v: v["frames"][1].update(fl_y=1e300), "focal length"),
        ("images", lambda v: v["frames"][1].update(file_path="images/a/b.png"), "end in a frame "),
        ("images", lambda v: v["frames"][1].update(file_path="images/a/1.png"), "images/a: is mis"),
        ("images", lambda v: v.update(test_filenames=["i/c/0.png"]), "filenames has i/c/0.png"),
        ("images", lambda v: v.update(test_filenames="c"), "test_filenames is not a list"),
        ("images", lambda v: v.update(fps=0), "fps is 0"),
        ("images listed", lambda v: v["frames"].pop(4), "camera cam01 lacks frame 8, which"),
        ("images listed", lambda v: v["frames"].pop(1), "frame 8 is missing before frame 9"),
        ("images listed", lambda v: turn(v["frames"][4]), "cam01/0007.png moves at images/cam01/0"),
        ("images listed", lambda v: v["frames"][4].update(fl_x=9), "changes its lens at"),
        ("images listed", lambda v: v["frames"][4].update(time=0.9), "time 0.9, but another"),
        ("frames listed", lambda v: [e.update(time=1) for e in v["frames"]], "do not rise"),
        ("times", lambda v: v["frames"][4].pop("time"), "names neither a camera nor"),
        ("times", lambda v: v["frames"][4].update(time=0), "same pose and time"),
        ("times", lambda v: turn(v["frames"][4]), "lacks frame"),
        ("times", lambda v: v["frames"][4].update(file_path="all/x.png"), "all/x.png: is missing"),
    ],
)  # fmt: skip
def test_bad_transforms_are_refused(
    tmp_path: Path, form: str, change: Callable[[dict[str, Any]], object], said: str
) -> None:
    write_nerfstudio(tmp_path, form)
    edit(tmp_path, change)
    assert said in refusal(tmp_path)


def test_transforms_that_are_not_a_json_object(tmp_path: Path) -> None:
    for text in ("", "{", "[1]", "\x00"):
        (tmp_path / "transforms.json").write_text(text)
        assert "transforms.json" in refusal(tmp_path)


def test_videos_that_do_not_fit(tmp_path: Path) -> None:
    cameras = tiny_rig(3)
    value = transforms_of(cameras, write_videos(tmp_path, cameras, 4))
    write_transforms(tmp_path, value)
    assert open_capture(tmp_path).num_frames == 4
    write_transforms(tmp_path, value | {"w": 128})
    assert "cam00.mp4: is 64x36 px" in refusal(tmp_path)
    (tmp_path / "videos/cam00.mp4").unlink()
    write_transforms(tmp_path, value)
    assert "cam00.mp4: is missing" in refusal(tmp_path)
    again = {**value["frames"][1], **intrinsics_of(cameras[0]), "file_path": "other/cam02.mp4"}
    write_transforms(tmp_path, value | {"frames": [value["frames"][2], again]})
    assert "are both camera cam02" in refusal(tmp_path)
