"""Videos like those of phones: HDR, rotated by metadata, at a variable rate."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest

from codec.camera import Camera
from tests.support.tiny_capture import HEIGHT_PX, WIDTH_PX, picture_of, refusal, tiny_rig
from tests.support.tiny_models import transforms_of, write_transforms
from trainer.capture.layout import open_capture

BT709, PQ, HLG = 1, 16, 18
TICKS = 600
"""Ticks per second of a video's time base."""


def film(
    path: Path, transfer: int = BT709, turned_deg: int = 0, times: Sequence[int] = range(0, 100, 20)
) -> None:
    """Writes a video with a frame at each of `times`, in ticks."""
    with av.open(str(path), "w") as output:
        stream = output.add_stream("libx264", rate=Fraction(30), options={"qp": "0"})
        stream.width, stream.height, stream.pix_fmt = WIDTH_PX, HEIGHT_PX, "yuv420p"
        stream.codec_context.color_trc = transfer
        stream.codec_context.time_base = stream.time_base = Fraction(1, TICKS)
        if turned_deg:
            stream.set_display_rotation(turned_deg)
        for number, time in enumerate(times):
            frame = av.VideoFrame.from_ndarray(picture_of(0, number), format="rgb24")
            frame = frame.reformat(format="yuv420p")
            frame.pts, frame.time_base = time, Fraction(1, TICKS)
            output.mux(stream.encode(frame))
        output.mux(stream.encode())


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


@pytest.mark.parametrize(("transfer", "name"), [(PQ, "PQ"), (HLG, "HLG")])
def test_hdr_is_refused_with_the_command_that_converts_it(
    transfer: int, name: str, rig: list[Camera], tmp_path: Path
) -> None:
    film(tmp_path / "cam03.mp4", transfer)
    told = refusal(tmp_path)
    assert told.startswith(f"{tmp_path}/cam03.mp4: is HDR ({name})")
    assert "ffmpeg -i cam03.mp4 -vf zscale=t=linear" in told
    for camera in rig:  # and if all cameras have the same fault
        film(tmp_path / f"{camera.name}.mp4", transfer)
    assert f"is HDR ({name})" in refusal(tmp_path)


def upright(camera: Camera) -> Camera:
    return replace(
        camera, width_px=HEIGHT_PX, height_px=WIDTH_PX, cx_px=HEIGHT_PX / 2, cy_px=WIDTH_PX / 2
    )


@pytest.mark.parametrize("turned_deg", [90, 180, -90])
def test_a_video_is_turned_counterclockwise_as_its_file_says(
    turned_deg: int, rig: list[Camera], tmp_path: Path
) -> None:
    film(tmp_path / "cam02.mp4", turned_deg=turned_deg)
    if turned_deg != 180:
        declare(tmp_path, [upright(c) if c.name == "cam02" else c for c in rig])
    capture = open_capture(tmp_path)
    with closing(capture.open_images(1)) as still, closing(capture.open_images(2)) as source:
        for frame in (3, 0):  # forward, and after a seek
            expected = np.rot90(still.read(frame), turned_deg // 90)
            np.testing.assert_array_equal(source.read(frame), expected)


def test_a_turned_video_of_another_size_is_named_with_its_turn(
    rig: list[Camera], tmp_path: Path
) -> None:
    film(tmp_path / "cam02.mp4", turned_deg=90)
    expected = f"{tmp_path}/cam02.mp4: is 36x64 px, turned by 90 degrees as the file says; "
    assert refusal(tmp_path).startswith(expected)
    film(tmp_path / "cam02.mp4", turned_deg=45)
    assert "only quarter turns are read" in refusal(tmp_path)


def test_a_rate_that_varies_is_named(rig: list[Camera], tmp_path: Path) -> None:
    film(tmp_path / "cam04.mp4", times=(0, 20, 40, 90, 130))
    told = refusal(tmp_path)
    assert "they must agree; the rate of cam04.mp4 varies: make it constant with ffmpeg" in told
    assert "-vf fps=30" in told
    film(tmp_path / "cam04.mp4", times=range(0, 125, 25))  # another rate, but a constant one
    told = refusal(tmp_path)
    assert told.endswith("they must agree")
