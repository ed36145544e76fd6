"""Tiny captures on disk, as dynerf and dynamic3dgs, whose pictures encode camera and frame."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
from PIL import Image

from codec.arrays import Bytes
from codec.camera import Camera
from codec.stream.manifest import Manifest
from trainer.capture.dynerf import encode_pose
from trainer.capture.layout import open_capture
from trainer.errors import CaptureError
from trainer.synth.scene import camera_rig

WIDTH_PX, HEIGHT_PX = 64, 36


def picture_of(camera_index: int, frame: int) -> Bytes:
    """(36, 64, 3) picture: red grows with the camera, green with the frame, blue along the rows."""
    picture = np.empty((HEIGHT_PX, WIDTH_PX, 3), np.uint8)
    picture[..., 0] = (20 + 25 * camera_index) % 256
    picture[..., 1] = (20 + 4 * frame) % 256
    picture[..., 2] = np.arange(HEIGHT_PX)[:, None] * 5
    return picture


def tiny_rig(num_cameras: int, arc_deg: float = 160.0) -> list[Camera]:
    return camera_rig(num_cameras, WIDTH_PX, HEIGHT_PX, float(np.radians(arc_deg)))


TICKS = 600
"""Ticks per second of a video's time base."""


def write_video(
    path: Path,
    camera_index: int,
    num_frames: int,
    table_in_front: bool = False,
    transfer: int = 1,
    turned_deg: int = 0,
    times: Sequence[int] | None = None,
    is_still: bool = False,
) -> None:
    """Writes a lossless video with B-frames and a key frame every 10 frames; times: of the frames,
    in ticks. is_still: all frames are one picture."""
    settings = {"qp": "0", "preset": "ultrafast", "bf": "2"}
    place = {"movflags": "faststart"} if table_in_front else {}
    container = "matroska" if path.suffix == ".mkv" else "mp4"
    with av.open(str(path), "w", format=container, options=place) as output:
        stream = output.add_stream("libx264", rate=Fraction(30), options=settings)
        stream.width, stream.height, stream.pix_fmt = WIDTH_PX, HEIGHT_PX, "yuv444p"
        stream.codec_context.gop_size, stream.codec_context.color_trc = 10, transfer
        stream.codec_context.time_base = stream.time_base = Fraction(1, TICKS)
        if turned_deg:
            stream.set_display_rotation(turned_deg)
        for number, time in enumerate(times or range(0, 20 * num_frames, 20)):
            picture = picture_of(camera_index, number * (not is_still))
            frame = av.VideoFrame.from_ndarray(picture, format="rgb24")
            frame.pts, frame.time_base = time, Fraction(1, TICKS)
            output.mux(stream.encode(frame))
        output.mux(stream.encode())


def seen_by(manifest: Manifest, capture: Path) -> Manifest:
    """`manifest` with the cameras of the capture at `capture`."""
    cameras = tuple(c.camera for c in open_capture(capture).cameras)
    return replace(manifest, cameras=cameras, default_camera=cameras[0].name)


def refusal(path: Path) -> str:
    """The error message that refuses the capture at `path`, one line."""
    with pytest.raises(CaptureError) as caught:
        open_capture(path)
    message = str(caught.value)
    assert "\n" not in message
    return message


def write_dynerf(root: Path, num_cameras: int = 3, num_frames: int = 5) -> list[Camera]:
    root.mkdir()
    cameras = tiny_rig(num_cameras)
    for index, camera in enumerate(cameras):
        write_video(root / f"{camera.name}.mp4", index, num_frames)
    np.save(root / "poses_bounds.npy", np.stack([encode_pose(c, 1.5, 9.0) for c in cameras]))
    return cameras


def meta_of(cameras: list[Camera], ids: list[int], num_frames: int) -> dict[str, Any]:
    k = [[[c.fx_px, 0, c.cx_px], [0, c.fy_px, c.cy_px], [0, 0, 1]] for c in cameras]
    return {
        "w": WIDTH_PX,
        "h": HEIGHT_PX,
        "k": [k] * num_frames,
        "w2c": [[c.w2c.tolist() for c in cameras]] * num_frames,
        "fn": [[f"{i}/{frame:06d}.png" for i in ids] for frame in range(num_frames)],
        "cam_id": [ids] * num_frames,
    }


def write_dynamic3dgs(root: Path, num_cameras: int = 4, num_frames: int = 3) -> list[Camera]:
    """Camera 1 is held out. Pictures are PNG, so that they can be compared exactly."""
    root.mkdir()
    (root / "fps.txt").write_text("30\n")
    cameras = tiny_rig(num_cameras)
    training = [i for i in range(num_cameras) if i != 1]
    for name, ids in (("train_meta.json", training), ("test_meta.json", [1])):
        meta = meta_of([cameras[i] for i in ids], ids, num_frames)
        (root / name).write_text(json.dumps(meta))
    for index in range(num_cameras):
        (root / "ims" / str(index)).mkdir(parents=True)
        for frame in range(num_frames):
            file = root / "ims" / str(index) / f"{frame:06d}.png"
            Image.fromarray(picture_of(index, frame)).save(file)
    return cameras
