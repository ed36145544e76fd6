"""`swings-synth`: a procedural capture, so that everything here can be tried without anyone's data.

A figure walks and waves in a room beside a bouncing ball (scene.py); the player's
renderer draws their surfaces as small discs (surfels.py). The capture has the DyNeRF layout of
capture/dynerf.py, ground truth for every camera, and coloured points on the surfaces of frame 0, as
a structure-from-motion tool would give them.
"""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from fractions import Fraction
from itertools import count, product
from pathlib import Path
from typing import Literal

import av
import av.video.stream
import numpy as np
import tyro
from av.video.reformatter import ColorRange, Colorspace
from rich.console import Console

from codec.arrays import Bytes, Floats
from codec.camera import Camera
from codec.errors import InvalidError
from codec.files import making_folder, name_file
from codec.progressline import counted
from codec.splats import Splats
from player.render.cpu import render_depth, render_splats
from trainer.capture.capture import HELD_OUT_NAME, Picture
from trainer.capture.dynerf import POINTS_NAME, POSES_NAME, encode_pose

from .scene import WALK_RADIUS_M, Scene, camera_rig, held_out_cameras

MAX_SIDE_PX = 4096
"""Largest width or height."""
NEAR_M = 0.05
"""Nearest depth that is drawn, metres."""
HIDDEN_M = 0.15
"""How far behind the surface of the room that a pixel shows things are hidden by it, metres: more
than surfaces recede within a pixel."""
BT709 = 1
"""Code of BT.709 for matrix, primaries and transfer in H.264."""
KEY_FRAME_S = 1.0
"""Time between key frames: what a random access may have to decode."""


@dataclass(frozen=True)
class SynthConfig:
    """A procedural capture of a walking figure and a bouncing ball, in the DyNeRF layout."""

    out: tyro.conf.Positional[Path]
    """Folder to make; must be missing or empty."""
    frames: int = 60
    """Number of frames of every camera."""
    fps: float = 30.0
    """Frames per second."""
    cameras: int = 16
    """Number of cameras on the arc, including the held-out ones."""
    held_out: int = 2
    """Number of cameras kept out of training, spread evenly among the others."""
    width_px: int = 320
    """Width of the pictures, pixels. Above 450, surfaces look softer than the pictures could."""
    height_px: int = 180
    """Height of the pictures, pixels."""
    arc_deg: float = 200.0
    """Angle between the first and the last camera, seen from the middle of the room, degrees."""
    walk_radius_m: float = WALK_RADIUS_M
    """Radius of the circle that the figure walks, metres. The cameras stand 3.2 m from its middle:
    at 2.5 m the figure passes right before them."""
    points: int = 12_000
    """Number of points on the surfaces that training cameras see at frame 0; 0 writes none."""
    seed: int = 0
    """Seed of the textures and of the start of the motion."""
    plain: Literal["sound", "silent"] | None = None
    """Makes what plain cameras film instead, for swings-capture calibrate: videos of lenses that
    bend, that begin up to 2 s apart, with claps to hear or without sound; and truth.json."""


def synthesise(config: SynthConfig, console: Console | None = None) -> None:
    """Writes the capture to `config.out`; nothing stands there before it is complete.

    console: where the progress line goes, standard error if None. Raises InvalidError for numbers
    that make no capture, and where the folder is taken.
    """
    check_config(config)
    with making_folder(config.out) as folder:
        try:
            _write_capture(config, folder, console)
        except OSError as error:
            name_file(error, config.out)
            raise


def check_config(config: SynthConfig) -> None:
    """Raises InvalidError for numbers that make no capture."""
    for name, value, least, most in (
        ("frames", config.frames, 1, 1_000_000),
        ("fps", config.fps, 0.1, 1000),
        ("cameras", config.cameras, 1, 256),
        ("width_px", config.width_px, 16, MAX_SIDE_PX),
        ("height_px", config.height_px, 16, MAX_SIDE_PX),
        ("arc_deg", config.arc_deg, 0, 340),
        ("walk_radius_m", config.walk_radius_m, 0.3, 2.9),
        ("points", config.points, 0, 10_000_000),
        ("seed", config.seed, 0, 1_000_000),
        ("held_out", config.held_out, 0, max(0, config.cameras - 2)),
    ):
        if not least <= value <= most:
            raise InvalidError(f"{name} {value:g}: must be between {least:g} and {most:g}")


def spacing_m(width_px: int) -> float:
    """Distance of the scene's surfels for pictures of a width: about a pixel, as far as a gigabyte
    holds them."""
    return float(np.clip(3.6 / width_px, 0.008, 0.03))


class Studio:
    """One camera's view of a scene: the room is drawn at construction, frames on demand."""

    def __init__(self, scene: Scene, camera: Camera) -> None:
        self._scene, self._camera = scene, camera
        room = scene.room()
        self._picture = render_splats(room, camera, NEAR_M)
        self._depth_m = render_depth(room, camera, NEAR_M)

    def film(self, frame: int) -> tuple[Picture, float]:
        """The picture (h, w, 3) of a frame, and the least depth that it shows, metres."""
        moving, nearest_m = self._visible(frame)
        drawn = render_splats(moving, self._camera, NEAR_M, alpha=True)
        picture = drawn[..., :3] + (1 - drawn[..., 3:]) * self._picture
        encoded = np.rint(np.clip(picture, 0, 1) * 255).astype(np.uint8)
        return encoded, min(nearest_m, float(self._depth_m.min()))

    def depth(self, frame: int) -> Floats:
        """(h, w) depth of what each pixel of a frame shows, metres."""
        moving_m = render_depth(self._visible(frame)[0], self._camera, NEAR_M)
        return np.where(np.isnan(moving_m), self._depth_m, moving_m)

    @property
    def farthest_m(self) -> float:
        """Largest depth of the room."""
        return float(self._depth_m.max())

    def _visible(self, frame: int) -> tuple[Splats, float]:
        """What moves in a frame and is not hidden by the room, and its least depth in the picture,
        metres."""
        splats, camera = self._scene.moving(frame), self._camera
        u_px, v_px, depth_m = camera.project(splats.means)
        columns = np.clip(np.nan_to_num(u_px), 0, camera.width_px - 1).astype(int)
        rows = np.clip(np.nan_to_num(v_px), 0, camera.height_px - 1).astype(int)
        shows = (depth_m > NEAR_M) & (depth_m < self._depth_m[rows, columns] + HIDDEN_M)
        inside = shows & (np.abs(u_px - columns) <= 1) & (np.abs(v_px - rows) <= 1)
        return splats.take(np.flatnonzero(shows)), float(depth_m[inside].min(initial=np.inf))

    def sample_points(self, count: int, rng: np.random.Generator) -> tuple[Floats, Bytes]:
        """(xyz (P, 3), rgb (P, 3)) of what randomly chosen pixels of frame 0 show."""
        picture, depth_m = self.film(0)[0], self.depth(0).astype(np.float64)
        rows = rng.integers(0, picture.shape[0], count)
        columns = rng.integers(0, picture.shape[1], count)
        xyz = self._camera.unproject(columns + 0.5, rows + 0.5, depth_m[rows, columns])
        return xyz.astype(np.float32), picture[rows, columns]


def _write_capture(config: SynthConfig, folder: Path, console: Console | None) -> None:
    scene = Scene(config.fps, config.seed, config.walk_radius_m, spacing_m(config.width_px))
    arc_rad = float(np.radians(config.arc_deg))
    cameras = camera_rig(config.cameras, config.width_px, config.height_px, arc_rad)
    held_out = held_out_cameras(cameras, config.held_out)
    places = [config.out / f"{camera.name}.mp4" for camera in cameras]
    studios, videos, near_m = [], [], [np.inf] * len(cameras)
    steps, total = count(1), (1 + config.frames) * len(cameras)
    with ExitStack() as stack, counted("filming", console) as show:
        for camera, place in zip(cameras, places, strict=True):
            studios.append(Studio(scene, camera))
            stack.enter_context(_named(place))
            video = VideoWriter(folder / place.name, camera, config.fps)
            videos.append(stack.enter_context(video))
            show(next(steps), total)
        # Frame by frame: what moves is made once for all cameras.
        for frame, one in product(range(config.frames), range(len(cameras))):
            picture, nearest_m = studios[one].film(frame)
            with _named(places[one]):
                videos[one].write(picture)
            near_m[one] = min(near_m[one], nearest_m)
            show(next(steps), total)
    rows = [
        encode_pose(camera, near, studio.farthest_m)
        for camera, near, studio in zip(cameras, near_m, studios, strict=True)
    ]
    poses = io.BytesIO()  # of a full disk numpy itself does not tell
    np.save(poses, np.stack(rows))
    (folder / POSES_NAME).write_bytes(poses.getvalue())
    (folder / HELD_OUT_NAME).write_text("".join(f"{name}\n" for name in held_out))
    if config.points:
        training = [n for n, camera in enumerate(cameras) if camera.name not in held_out]
        each = -(-config.points // len(training))
        found = [
            studios[n].sample_points(each, np.random.default_rng([config.seed, n]))
            for n in training
        ]
        xyz, rgb = (np.concatenate(part)[: config.points] for part in zip(*found, strict=True))
        np.savez(folder / POINTS_NAME, xyz=xyz, rgb=rgb)


@contextmanager
def _named(place: Path) -> Iterator[None]:
    """Has errors of a full or broken disk name `place`."""
    try:
        yield
    except OSError as error:
        if str(error.filename).startswith("file:"):  # as FFmpeg calls what it writes
            raise OSError(error.errno, error.strerror, str(place)) from error
        name_file(error, place)
        raise


class VideoWriter:
    """A lossless H.264 video in full colour resolution, tagged BT.709.

    What remains is the rounding of 8-bit RGB to YUV and back, 52 dB. Lossy settings cost 6 to 14 dB
    of that, and the videos are the ground truth of every measurement made with them.
    """

    def __init__(self, path: Path, camera: Camera, fps: float) -> None:
        self._container = av.open(f"file:{path}", "w")  # the prefix allows colons in the path
        stream = self._container.add_stream(
            "libx264",
            rate=Fraction(fps).limit_denominator(1001),
            options={"qp": "0", "preset": "veryfast"},
        )
        stream.width, stream.height = camera.width_px, camera.height_px
        stream.pix_fmt = "yuv444p"
        context = stream.codec_context
        context.gop_size = max(1, round(fps * KEY_FRAME_S))
        context.thread_count = 1
        context.colorspace = context.color_primaries = context.color_trc = BT709
        context.color_range = ColorRange.MPEG
        self._stream: av.video.stream.VideoStream = stream

    def write(self, picture: Picture) -> None:
        """Adds a frame, (h, w, 3) RGB."""
        frame = av.VideoFrame.from_ndarray(picture, format="rgb24")
        frame = frame.reformat(format="yuv444p", dst_colorspace=Colorspace.ITU709)
        self._container.mux(self._stream.encode(frame))

    def __enter__(self) -> VideoWriter:
        return self

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        try:
            if kind is None:
                self._container.mux(self._stream.encode())
        finally:
            self._container.close()
