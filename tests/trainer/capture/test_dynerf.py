"""The DyNeRF layout: poses, videos read in any order, refusals; and videos of phones."""

from __future__ import annotations

import shutil
from contextlib import closing
from dataclasses import replace
from fractions import Fraction
from itertools import product
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
from PIL import Image

from codec.arrays import Bytes
from codec.camera import Camera
from codec.errors import InvalidError
from tests.support import tiny_capture
from tests.support.hostile import refused
from tests.support.tiny_capture import picture_of, refusal, tiny_rig, write_dynerf, write_video
from tests.support.tiny_models import transforms_of, write_transforms
from trainer.capture.dynerf import decode_pose, encode_pose
from trainer.capture.layout import open_capture
from trainer.capture.video import MAX_SKIP_FRAMES, VideoSource, probe_video
from trainer.errors import CaptureError

NUM_FRAMES, WIDTH_PX, HEIGHT_PX = 50, tiny_capture.WIDTH_PX, tiny_capture.HEIGHT_PX


@pytest.fixture(scope="module")
def long_video(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("video") / "cam00.mp4"
    write_video(path, 3, NUM_FRAMES)
    return path


@pytest.fixture
def capture_path(tmp_path: Path) -> Path:
    write_dynerf(tmp_path / "c")
    return tmp_path / "c"


def nearly(picture: Bytes, camera_index: int, frame: int) -> bool:
    """Whether it is that picture, except for rounding from RGB to YUV and back."""
    difference = picture.astype(int) - picture_of(camera_index, frame)
    return int(np.abs(difference).max()) <= 2


def test_llff_axes() -> None:
    # A camera at (1, 2, 3) that looks along the world's -z with the world's y up, in the form of
    # LLFF: down = -y, right = x, backwards = z.
    matrix = [[0, 1, 0, 1, 36], [-1, 0, 0, 2, 64], [0, 0, 1, 3, 50]]
    row = np.array([*np.ravel(matrix), 1.0, 9.0])
    camera = decode_pose(row, "cam00", Path("poses"))
    assert np.allclose(camera.position, (1, 2, 3))
    assert np.allclose(camera.forward, (0, 0, -1))
    assert np.allclose(camera.w2c[0, :3], (1, 0, 0))
    assert np.allclose(camera.w2c[1, :3], (0, -1, 0))
    assert (camera.width_px, camera.height_px, camera.fx_px) == (64, 36, 50)
    assert (camera.cx_px, camera.cy_px) == (32, 18)
    np.testing.assert_allclose(encode_pose(camera, 1, 9), row)
    refused(InvalidError, "one focal length", encode_pose, replace(camera, fy_px=51), 1, 9)


def test_what_is_no_video_or_none_of_the_others_is_refused(capture_path: Path) -> None:
    video = capture_path / "cam01.mp4"
    write_video(video, 1, 4)
    assert "cam01.mp4 has 4, the others 5 frames" in refusal(capture_path)
    for data in (b"hello " * 100, b""):
        video.write_bytes(data)
        assert "cam01.mp4: not a video that can be read" in refusal(capture_path)
    Image.fromarray(picture_of(0, 0)).save(video, "JPEG")
    assert "cam01.mp4" in refusal(capture_path)
    with av.open(str(video), "w", format="wav") as output:
        track = output.add_stream("pcm_s16le", rate=8000, layout="mono")
        sound = av.AudioFrame.from_ndarray(np.zeros((1, 800), np.int16), "s16", "mono")
        sound.sample_rate = 8000
        output.mux(track.encode(sound))
    assert "holds no video" in refusal(capture_path)
    video.unlink()
    assert "3 poses for 2 videos" in refusal(capture_path)
    for video in capture_path.glob("*.mp4"):
        video.unlink()
    assert "no camNN.mp4" in refusal(capture_path)


def test_bad_poses_are_refused(capture_path: Path) -> None:
    path = capture_path / "poses_bounds.npy"
    rows = np.load(path)
    # The columns of a row: a 3x5 matrix, whose last column is height, width and focal length.
    for row, column, value, said in (
        (1, 9, 128, "cam01.mp4: is 64x36 px; poses_bounds.npy declares 128x36 px"),
        (0, 3, np.nan, "not finite"),
        (2, 0, 5, "cam02"),
        (1, 15, 99, "0 < near < far"),
        (0, 4, 36.5, "is not whole"),
        (1, 14, 1e-300, "focal length"),
    ):
        wrong = rows.copy()
        wrong[row, column] = value
        np.save(path, wrong)
        assert said in refusal(capture_path)
    np.save(path, rows[:, :15])
    assert "has shape (3, 15)" in refusal(capture_path)
    np.save(path, np.array(["a" * 17]))
    assert "shape" in refusal(capture_path)
    with open(path, "wb") as file:  # rows that a header only claims
        claim = {"descr": "<f8", "fortran_order": False, "shape": (10**11, 17)}
        np.lib.format.write_array_header_1_0(file, claim)
        file.write(bytes(24))
    assert "poses_bounds.npy" in refusal(capture_path)
    path.write_bytes(b"nonsense")
    assert "not a .npy file" in refusal(capture_path)
    path.unlink()
    assert "3 videos, but no poses of their cameras" in refusal(capture_path)


def test_smaller_videos_and_names_in_upper_case(capture_path: Path) -> None:
    for video in capture_path.glob("*.mp4"):
        video.rename(video.with_suffix(".MP4"))
    path = capture_path / "poses_bounds.npy"
    rows = np.load(path)
    rows[:, [4, 9, 14]] *= 2  # height, width and focal length
    np.save(path, rows)
    capture = open_capture(capture_path)
    (doubt,) = capture.doubts
    assert "64x36 px, where poses_bounds.npy declares 128x72; its intrinsics are scaled" in doubt
    for entry, camera in zip(capture.cameras, tiny_rig(3), strict=True):
        np.testing.assert_allclose(entry.camera.intrinsics, camera.intrinsics)
    rows[1, [4, 9]] *= 2
    np.save(path, rows)
    assert "cam00.MP4: is 64x36 px; poses_bounds.npy declares 128x72 px" in refusal(capture_path)


PAINT = np.array([*bytes.fromhex("ffffff ff0000 00ff00 0000ff 808080 c8783c 3ca05a 101010")])


@pytest.mark.parametrize(
    ("matrix", "spread"), [(None, None), (6, 1), (6, 2), (1, None), (1, 1), (1, 2)]
)
def test_colours_are_the_filmed_ones(
    matrix: int | None, spread: int | None, tmp_path: Path
) -> None:
    """Encodings by their numbers in ITU-T H.273, as far as the file has them: matrix 1 is BT.709,
    which PyAV below 17 reads as BT.601, and range 2 is the full one."""
    kr, kb = (0.2126, 0.0722) if matrix == 1 else (0.299, 0.114)
    rgb, tags = PAINT.reshape(-1, 3) / 255, {"colorspace": matrix, "color_range": spread}
    y = rgb @ (kr, 1 - kr - kb, kb)
    cb, cr = (rgb[:, 2] - y) / (2 * (1 - kb)), (rgb[:, 0] - y) / (2 * (1 - kr))
    rise, span, wide = (0, 255, 255) if spread == 2 else (16, 219, 224)
    bright = np.tile(np.repeat(span * y + rise, 8), HEIGHT_PX)
    halves = [np.tile(np.repeat(wide * c + 128, 4), HEIGHT_PX // 2) for c in (cb, cr)]
    planes = np.rint(np.concatenate([bright, *halves])).clip(0, 255).astype(np.uint8)
    path = tmp_path / "cam00.mp4"
    with av.open(str(path), "w") as output:
        stream = output.add_stream("libx264", rate=Fraction(30), options={"qp": "0"})
        stream.width, stream.height, stream.pix_fmt = WIDTH_PX, HEIGHT_PX, "yuv420p"
        frame = av.VideoFrame.from_ndarray(planes.reshape(-1, WIDTH_PX), format="yuv420p")
        for (name, tag), what in product(tags.items(), (stream.codec_context, frame)):
            if tag is not None:
                setattr(what, name, tag)
        output.mux(stream.encode(frame))
        output.mux(stream.encode())
    with closing(VideoSource(path, tiny_rig(1)[0], 1)) as source:
        assert np.abs(source.read(0)[18, 4::8] - 255 * rgb).max() <= 3


def video_at(path: Path) -> VideoSource:
    return VideoSource(path, tiny_rig(1)[0], NUM_FRAMES)


def test_any_order_gives_the_same_pictures_and_forward_decodes_each_once(long_video: Path) -> None:
    forward = video_at(long_video)
    pictures = [forward.read(frame) for frame in range(NUM_FRAMES)]
    assert all(nearly(picture, 3, frame) for frame, picture in enumerate(pictures))
    assert forward.decoded_frames == NUM_FRAMES
    forward.close()
    assert np.array_equal(forward.read(2), pictures[2])  # opened again
    forward.close()
    rng = np.random.default_rng(5)
    with closing(video_at(long_video)) as source:
        orders = [rng.permutation(NUM_FRAMES).tolist(), [*range(NUM_FRAMES)][::-1], [49, 0, 49]]
        for order in orders:
            for frame in order:
                assert np.array_equal(source.read(frame), pictures[frame]), frame
        for frame in (-1, NUM_FRAMES):
            refused(InvalidError, "50 frames", source.read, frame)


def test_a_far_frame_costs_one_group_of_pictures(long_video: Path) -> None:
    with closing(video_at(long_video)) as source:
        for frame, most in ((47, 10), (48, 11), (5, 11 + MAX_SKIP_FRAMES)):
            assert nearly(source.read(frame), 3, frame)
            assert source.decoded_frames <= most


def test_frames_are_counted_where_no_header_tells(capture_path: Path, tmp_path: Path) -> None:
    write_video(tmp_path / "v.mkv", 1, 5)
    shutil.move(tmp_path / "v.mkv", capture_path / "cam01.mp4")
    assert probe_video(capture_path / "cam01.mp4").num_frames == 5
    capture = open_capture(capture_path)
    assert (capture.num_frames, capture.fps) == (5, 30.0)
    assert nearly(capture.open_images(1).read(4), 1, 4)


def test_a_cut_video_is_named_when_its_end_is_read(tmp_path: Path) -> None:
    # A truncated MP4 with its table in front still lists all its frames.
    cut = tmp_path / "cam01.mp4"
    write_video(cut, 1, NUM_FRAMES, table_in_front=True)
    whole = cut.read_bytes()
    cut.write_bytes(whole[: len(whole) // 2])
    assert probe_video(cut).num_frames == NUM_FRAMES
    with closing(video_at(cut)) as source:
        assert nearly(source.read(3), 1, 3)
        for frame in (NUM_FRAMES - 1, NUM_FRAMES - 1):
            refused(CaptureError, r"cam01\.mp4", source.read, frame)
        assert nearly(source.read(2), 1, 2)


PQ, HLG = 16, 18


def film(path: Path, num_frames: int = 5, **more: Any) -> None:
    write_video(path, 0, num_frames, **more)


@pytest.fixture
def rig(tmp_path: Path) -> list[Camera]:
    """A nerfstudio capture of ordinary videos, cam00.mp4 to cam06.mp4."""
    cameras = tiny_rig(7)
    for camera in cameras:
        film(tmp_path / f"{camera.name}.mp4")
    declare(tmp_path, cameras)
    return cameras


def declare(root: Path, cameras: list[Camera]) -> None:
    write_transforms(root, transforms_of(cameras, [[f"{c.name}.mp4"] for c in cameras]))


def test_hdr_is_refused_with_a_command_that_converts_it(rig: list[Camera], tmp_path: Path) -> None:
    for transfer, name in ((PQ, "PQ"), (HLG, "HLG")):
        film(tmp_path / "cam03.mp4", transfer=transfer)
        told = refusal(tmp_path)
        assert told.startswith(f"{tmp_path}/cam03.mp4: is HDR ({name})")
        assert "ffmpeg -i cam03.mp4 -vf zscale=t=linear" in told
    for camera in rig:  # and if all cameras have the same fault
        film(tmp_path / f"{camera.name}.mp4", transfer=HLG)
    assert "is HDR (HLG)" in refusal(tmp_path)


@pytest.mark.parametrize("turned_deg", [90, 180, -90])
def test_a_video_is_turned_as_it_says(turned_deg: int, rig: list[Camera], tmp_path: Path) -> None:
    film(tmp_path / "cam02.mp4", turned_deg=turned_deg)
    if turned_deg != 180:
        upright = {"width_px": 36, "height_px": 64, "cx_px": 18, "cy_px": 32}
        declare(tmp_path, [replace(c, **upright) if c.name == "cam02" else c for c in rig])  # type: ignore[arg-type]
    capture = open_capture(tmp_path)
    with closing(capture.open_images(1)) as still, closing(capture.open_images(2)) as source:
        for frame in (3, 0):  # forward, and after a seek
            expected = np.rot90(still.read(frame), turned_deg // 90)
            np.testing.assert_array_equal(source.read(frame), expected)


def test_turned_videos_sizes_and_other_rates_are_named(rig: list[Camera], tmp_path: Path) -> None:
    film(tmp_path / "cam02.mp4", turned_deg=90)
    expected = f"{tmp_path}/cam02.mp4: is 36x64 px, turned by 90 degrees as the file says; "
    assert refusal(tmp_path).startswith(expected)
    film(tmp_path / "cam02.mp4", turned_deg=45)
    assert "only quarter turns are read" in refusal(tmp_path)
    film(tmp_path / "cam02.mp4", times=range(0, 125, 25))  # another rate, but a constant one
    assert refusal(tmp_path).endswith("they must agree")


def test_videos_of_variable_rate_must_show_the_same_moments(
    rig: list[Camera], tmp_path: Path
) -> None:
    film(tmp_path / "cam02.mp4", times=(0, 20, 40, 90, 130))
    told = refusal(tmp_path)
    assert "frame 3 is at 0.100 s in cam00.mp4 and at 0.150 s in cam02.mp4; the rate of " in told
    assert "cam02.mp4 varies: make it constant with ffmpeg -i cam02.mp4 -vf fps=30 " in told
    assert "-frames:v 5 " in told  # as many as the others have
    film(tmp_path / "cam02.mp4", times=(0, 21, 38, 62, 80))  # off by less than half a frame
    assert open_capture(tmp_path).num_frames == 5
    for number, camera in enumerate(rig):  # counts and mean rates agree, the moments do not
        times = [20 * n for n in range(10) if n != 1 + number]
        film(tmp_path / f"{camera.name}.mp4", times=times)
    told = refusal(tmp_path)
    assert "frame 1 is at 0.033 s in cam01.mp4 and at 0.067 s in cam00.mp4; the rate of " in told
    assert "cam00.mp4, cam01.mp4, cam02.mp4, cam03.mp4 and 3 more varies" in told
    assert "-vf fps=30 -c:v" in told
