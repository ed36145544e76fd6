"""The COLMAP layout: models in both forms, both picture layouts, distortion, refusals."""

from __future__ import annotations

import re
import shutil
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from codec.arrays import Bytes, Doubles
from tests.support.tiny_capture import HEIGHT_PX, WIDTH_PX, picture_of, refusal, tiny_rig
from tests.support.tiny_models import COLOURS, POINTS, write_model, write_pictures
from trainer.capture.layout import open_capture
from trainer.capture.lens import Lens, straightened
from trainer.capture.masks import mask_source
from trainer.run.check import describe_capture

NUM_FRAMES = 3


def write_colmap(root: Path, binary: bool = True, by_frame: bool = True) -> list[list[str]]:
    """Returns the paths of the pictures, by camera and frame."""
    cameras = tiny_rig(3)
    suffix = ".png" if by_frame else "/0007.png"
    write_model(root / "sparse/0", cameras, [c.name + suffix for c in cameras], binary)
    return write_pictures(root, cameras, NUM_FRAMES, by_frame)


@pytest.mark.parametrize("binary", [True, False])
@pytest.mark.parametrize("by_frame", [True, False])
def test_capture_as_written(tmp_path: Path, binary: bool, by_frame: bool) -> None:
    write_colmap(tmp_path, binary, by_frame)
    capture = open_capture(tmp_path)
    assert (capture.layout, capture.num_frames, capture.fps) == ("colmap", NUM_FRAMES, None)
    assert capture.held_out == (1,)
    assert capture.points is not None
    assert np.array_equal(capture.points.xyz, np.array(POINTS, np.float32))
    assert np.array_equal(capture.points.rgb, COLOURS)
    assert capture.near_m is not None
    for index, camera in enumerate(tiny_rig(3)):
        got = capture.cameras[index].camera
        assert got.name == camera.name
        assert np.allclose(got.w2c, camera.w2c, atol=1e-12)
        assert np.array_equal(got.intrinsics, camera.intrinsics)
        for frame in (2, 0):
            picture = capture.open_images(index).read(frame)
            assert np.array_equal(picture, picture_of(index, frame))


def test_a_model_without_a_numbered_folder_or_points_and_a_rate_in_a_file(tmp_path: Path) -> None:
    write_colmap(tmp_path)
    (tmp_path / "sparse/0").rename(tmp_path / "aside")
    (tmp_path / "sparse").rmdir()
    (tmp_path / "aside").rename(tmp_path / "sparse")
    (tmp_path / "sparse/points3D.bin").unlink()
    (tmp_path / "fps.txt").write_text("59.94\n")
    capture = open_capture(tmp_path)
    assert (capture.points, capture.fps) == (None, 59.94)
    for text in ("fast", "0", "nan"):
        (tmp_path / "fps.txt").write_text(text)
        assert "fps.txt" in refusal(tmp_path)


def test_a_forward_rig_takes_its_depths_from_the_points_and_names_sort_by_numbers(
    tmp_path: Path,
) -> None:
    names = "c10", "c2", "d"
    cameras = [replace(c, name=n) for c, n in zip(tiny_rig(3, arc_deg=10), names, strict=True)]
    write_model(tmp_path / "sparse/0", cameras, [f"{c.name}.png" for c in cameras], True)
    write_pictures(tmp_path, cameras, 1, True)
    capture = open_capture(tmp_path)
    depths = np.array([(np.array(POINTS) @ c.w2c[2, :3]) + c.w2c[2, 3] for c in cameras])
    assert capture.near_m == pytest.approx(0.9 * depths.min(), rel=0.01)
    assert capture.far_m == pytest.approx(1.1 * depths.max(), rel=0.01)
    assert [c.camera.name for c in capture.cameras] == ["c2", "c10", "d"]


@pytest.mark.parametrize(
    ("model", "distortion", "lens"),
    [
        ("SIMPLE_RADIAL", (-0.12,), Lens(k1=-0.12)),
        ("RADIAL", (-0.15, 0.04), Lens(k1=-0.15, k2=0.04)),
        ("OPENCV", (-0.1, 0.02, 0.003, -0.004), Lens(k1=-0.1, k2=0.02, p1=0.003, p2=-0.004)),
    ],
)
def test_each_lens(tmp_path: Path, model: str, distortion: tuple[float, ...], lens: Lens) -> None:
    """What lenses do to a picture is shown below."""
    camera = tiny_rig(1)[0]
    write_model(tmp_path / "sparse/0", [camera], ["cam00.png"], True, model, distortion)
    write_pictures(tmp_path, [camera], 2, True)
    capture = open_capture(tmp_path)
    assert np.array_equal(capture.cameras[0].camera.intrinsics, camera.intrinsics)
    expected = straightened(picture_of(0, 1), camera, lens)
    assert np.array_equal(capture.open_images(0).read(1), expected)
    assert not np.array_equal(expected, picture_of(0, 1))


def test_a_straightened_picture_is_that_of_a_pinhole() -> None:
    lens = Lens(k1=-0.12, k2=0.03, k3=0.01, p1=0.004, p2=-0.003)
    camera = tiny_rig(1)[0].scaled(4)

    def shades(x: Doubles, y: Doubles) -> Bytes:
        grey = 128 + 60 * np.sin(9 * x + 2) * np.cos(7 * y) + 50 * np.sin(5 * y + x)
        return np.repeat(np.rint(grey)[..., None], 3, axis=2).astype(np.uint8)

    v, u = np.mgrid[: camera.height_px, : camera.width_px] + 0.5
    bent_x, bent_y = (u - camera.cx_px) / camera.fx_px, (v - camera.cy_px) / camera.fy_px
    x, y = bent_x, bent_y
    for _ in range(50):  # where the lens takes from what it shows, as OpenCV's manual has it
        r2 = x * x + y * y
        radial = 1 + lens.k1 * r2 + lens.k2 * r2**2 + lens.k3 * r2**3
        aside = 2 * x * y * lens.p1 + lens.p2 * (r2 + 2 * x * x)
        down = 2 * x * y * lens.p2 + lens.p1 * (r2 + 2 * y * y)
        x, y = (bent_x - aside) / radial, (bent_y - down) / radial
    pinhole = shades(bent_x, bent_y).astype(int)
    assert np.abs(straightened(shades(x, y), camera, lens) - pinhole).max() <= 2
    assert np.abs(shades(x, y) - pinhole).max() > 20


def test_pixels_that_a_lens_does_not_show_do_not_count(tmp_path: Path) -> None:
    camera = tiny_rig(1)[0]
    picture = np.random.default_rng(1).integers(0, 256, (HEIGHT_PX, WIDTH_PX, 3), np.uint8)
    assert np.array_equal(straightened(picture, camera, Lens()), picture)
    assert mask_source(camera, Lens(k1=-0.1), ()) is None
    pincushion = mask_source(camera, Lens(k1=0.5), ())
    assert pincushion is not None
    seen = pincushion.read(7)
    assert not seen[[0, -1, 0, -1], [0, 0, -1, -1]].any()
    assert seen[8:-8, 8:-8].all()
    rays = np.mgrid[:HEIGHT_PX, :WIDTH_PX][::-1] + 0.5 - np.array([32, 18])[:, None, None]
    radii2 = (rays**2).sum(axis=0) / camera.fx_px**2
    r2 = np.sort(radii2.ravel())[-17:-15].mean()  # of 16 pixels the bent radius does not grow
    k1 = -1 / 3 / r2
    write_model(tmp_path / "sparse", [camera], ["cam00.png"], True, "SIMPLE_RADIAL", (k1,))
    write_pictures(tmp_path, [camera], 1, True)
    capture = open_capture(tmp_path)
    masks = capture.cameras[0].masks
    assert masks is not None
    assert np.array_equal(masks.read(0) == 0, radii2 >= r2)
    assert capture.doubts[0].startswith("lenses that fold: 0.69% of cam00 do not count")
    assert "masks       none: every pixel counts that its lens shows" in describe_capture(capture)


@pytest.mark.parametrize("by_frame", [True, False])
def test_the_largest_of_several_models_is_read_and_cameras_without_pose_named(
    by_frame: bool, tmp_path: Path
) -> None:
    paths = write_colmap(tmp_path, by_frame=by_frame)
    names = [path.split("/")[-1] if by_frame else path[7:] for path, *_ in paths]
    write_model(tmp_path / "sparse/1", tiny_rig(3)[:2], names[:2], False)
    (doubt,) = open_capture(tmp_path).doubts
    assert "2 models in sparse/: 0, which has the most images (3), is read, and 1 (2)" in doubt
    shutil.rmtree(tmp_path / "sparse/0")
    capture = open_capture(tmp_path)
    (doubt,) = capture.doubts
    assert doubt.startswith("pictures without a pose: those of cam02 are left out")
    assert [entry.camera.name for entry in capture.cameras] == ["cam00", "cam01"]


@pytest.mark.parametrize("binary", [True, False])
def test_lenses_that_are_refused(tmp_path: Path, binary: bool) -> None:
    camera = tiny_rig(1)
    write_pictures(tmp_path, camera, 1, True)
    for model, distortion, said in (
        ("OPENCV_FISHEYE", (0.1, 0, 0, 0), "camera cam00 has the lens model OPENCV_FISHEYE"),
        ("SIMPLE_RADIAL", (-0.9,), r"camera cam00: the distortion folds \d+% of the picture over"),
        ("SIMPLE_RADIAL", (float("nan"),), "cam00: a distortion term is not a number"),
    ):
        shutil.rmtree(tmp_path / "sparse", ignore_errors=True)
        write_model(tmp_path / "sparse", camera, ["cam00.png"], binary, model, distortion)
        assert re.search(rf"cameras\..*{said}", refusal(tmp_path))


@pytest.mark.parametrize("name", ["cameras", "images", "points3D"])
def test_binary_files_cut_anywhere_or_continued(tmp_path: Path, name: str) -> None:
    write_colmap(tmp_path)
    path = tmp_path / "sparse/0" / f"{name}.bin"
    whole = path.read_bytes()
    for size in range(len(whole)):
        path.write_bytes(whole[:size])
        assert f"{name}.bin: ends in the middle" in refusal(tmp_path)
    path.write_bytes(whole + b"x")
    assert f"{name}.bin: 1 bytes follow" in refusal(tmp_path)
    for count in (1, 4, 2**64 - 1):
        path.write_bytes(struct.pack("<Q", count) + whole[8:])
        assert f"{name}.bin" in refusal(tmp_path)


@pytest.mark.parametrize("name", ["cameras", "images", "points3D"])
def test_text_files_with_another_count_or_words(tmp_path: Path, name: str) -> None:
    write_colmap(tmp_path, binary=False)
    path = tmp_path / "sparse/0" / f"{name}.txt"
    text = path.read_text()
    for data, said in (
        (text.replace(": 3", ": 4").encode(), "declares 4 rows, has 3"),
        ((text + "99 word\n").encode(), "line"),
        (b"\xff\xfe" + text.encode(), "not text"),
    ):
        path.write_bytes(data)
        assert f"{name}.txt: {said}" in refusal(tmp_path)


@pytest.mark.parametrize(
    ("name", "before", "after", "said"),
    [
        ("cameras", "PINHOLE", "RADIAL", "RADIAL has 5 parameters, not 4"),
        ("cameras", "\n2 P", "\n1 P", "cameras.txt: camera 1 is listed twice"),
        ("cameras", "\n2 P", "\n5 P", "image cam01.png names camera 2"),
        ("cameras", f" {WIDTH_PX} ", " 65 ", "cam00.png: is 64x36 px"),
        ("cameras", f" {WIDTH_PX} ", " 0 ", "cameras.txt: camera cam00: size 0x36"),
        ("images", "cam01.png", "../cam01.png", "images.txt: '../cam01.png' is not a path inside"),
        ("images", "cam01.png", "cam00.jpg", "cam00.jpg and cam00.png are both camera cam00"),
        ("images", "cam01.png", "cam\x0001.png", "is not a path inside"),
        ("cameras", "(64 36) \\S+", r"\1 1e-300", "cameras.txt: camera cam00: focal length"),
        ("images", "(?s).+", "9 1 0 0 0 1e200 2 3 1 a.png\n\n", "is over 1e+09 m away"),
        ("images", "(?s).+", "# nothing", "images.txt: has no images"),
        ("images", "(?s).+", "9 0 0 0 0 1 2 3 1 a.png\n\n", "image a.png: its quaternion"),
        ("images", "(?s).+", "9 1e200 0 0 0 1 2 3 1 a.png\n\n", "image a.png: its quaternion"),
    ],
)
def test_contradicting_rows(tmp_path: Path, name: str, before: str, after: str, said: str) -> None:
    write_colmap(tmp_path, binary=False)
    path = tmp_path / "sparse/0" / f"{name}.txt"
    changed, count = re.subn(before, after, path.read_text())
    assert count
    path.write_text(changed)
    assert said in refusal(tmp_path)


def test_bytes_of_a_model_that_are_none(tmp_path: Path) -> None:
    write_colmap(tmp_path)
    folder = tmp_path / "sparse/0"
    for name, at, data, said in (
        ("points3D.bin", 16, struct.pack("<d", 1e300), "a point is over 1e+09 m away"),
        ("points3D.bin", 16, struct.pack("<d", np.nan), "points: a coordinate is not finite"),
        ("cameras.bin", 12, b"\x4d", "camera 1 has the unknown model number 77"),
    ):
        whole = (folder / name).read_bytes()
        (folder / name).write_bytes(whole[:at] + data + whole[at + len(data) :])
        assert f"{name}: {said}" in refusal(tmp_path)
        (folder / name).write_bytes(whole)
    (folder / "images.bin").unlink()
    assert "images.bin: is missing" in refusal(tmp_path)
    (folder / "cameras.bin").unlink()
    assert "cameras.bin or cameras.txt" in refusal(tmp_path)


def test_missing_pictures_are_named(tmp_path: Path) -> None:
    frames, by_camera = tmp_path / "f", tmp_path / "c"
    write_colmap(frames)
    (frames / "frames/frame_08/cam01.png").unlink()
    assert "frame_08/cam01.png: is missing" in refusal(frames)
    (frames / "frames/frame_08").rename(tmp_path / "aside")
    assert "frames: frame 8 is missing before frame 9" in refusal(frames)
    (tmp_path / "aside").rename(frames / "frames/other_9")
    assert "frame 9 is also" in refusal(frames)
    shutil.rmtree(frames / "frames")
    assert "frames: is missing, and so is images/" in refusal(frames)
    (frames / "frames").mkdir()
    assert "holds no numbered frames" in refusal(frames)
    write_colmap(by_camera, by_frame=False)
    path = by_camera / "images/cam01"
    (path / "._0008.png").touch()
    (path / "notes.txt").touch()
    assert open_capture(by_camera).num_frames == NUM_FRAMES
    (path / "0008.png").rename(path / "0010.png")
    assert "cam01: lacks frame 8" in refusal(by_camera)
    for file in path.iterdir():
        file.unlink()
    assert "cam01: holds no numbered frames" in refusal(by_camera)
    path.rmdir()
    assert "cam01: is missing" in refusal(by_camera)
