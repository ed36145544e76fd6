"""`swings-synth`: a procedural capture, so that everything here can be tried without anyone's data.

A figure walks and waves in a room beside a bouncing ball (motion.py, scene.py). The capture has the
DyNeRF layout of capture/dynerf.py, ground truth for every camera, and coloured points on the
surfaces of frame 0, as a structure-from-motion tool would give them.
"""

from __future__ import annotations

import io
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from fractions import Fraction
from itertools import count
from pathlib import Path

import av
import av.video.stream
import numpy as np
import numpy.typing as npt
import tyro
from av.video.reformatter import ColorRange, Colorspace
from rich.console import Console

from codec.camera import Camera
from codec.errors import InvalidError
from codec.files import making_folder, name_file
from codec.progressline import counted
from trainer.capture.capture import Picture
from trainer.capture.dynerf import POINTS_NAME, POSES_NAME, encode_pose
from trainer.capture.held_out import HELD_OUT_NAME

from .motion import WALK_RADIUS_M, Moving, moving_parts
from .scene import (
    LAMP_AT,
    ROOM,
    camera_rig,
    fixtures,
    furniture,
    held_out_cameras,
    wall_pictures,
)
from .solid import Boxes, Parts, Table
from .trace import BUFFER_COLUMNS, RAYS_PER_PIXEL, trace_frame, trace_room

Floats = npt.NDArray[np.float32]

MAX_SIDE_PX = 4096
"""Largest width or height: one camera's room buffer takes 208 bytes a pixel."""
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
    """Width of the pictures, pixels."""
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


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """All that every camera sees: the room, and the moving parts of every frame."""

    boxes: Boxes
    fixtures: Parts
    wall_pictures: Table
    moving: tuple[Moving, ...]
    seed: int


@dataclass(frozen=True, slots=True, eq=False)
class Take:
    """Facts about one filmed camera, besides its video."""

    near_m: float
    """Least depth of anything seen, metres."""
    far_m: float
    """Largest."""
    xyz: Floats  # (P, 3) metres, world: sampled from frame 0
    rgb: npt.NDArray[np.uint8]  # (P, 3)


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


def make_scene(
    num_frames: int, fps: float, seed: int, walk_radius_m: float = WALK_RADIUS_M
) -> Scene:
    """The scene in each of its frames."""
    moving = tuple(moving_parts(frame / fps, seed, walk_radius_m) for frame in range(num_frames))
    return Scene(furniture(), fixtures(seed), wall_pictures(), moving, seed)


class Studio:
    """One camera's view of a scene: the room is traced at construction, frames on demand."""

    def __init__(self, scene: Scene, camera: Camera) -> None:
        self._scene = scene
        self._camera = camera
        size = camera.height_px, camera.width_px
        self._buffer = np.empty((*size, RAYS_PER_PIXEL, BUFFER_COLUMNS), np.float32)
        self._room = np.empty((*size, 3), np.uint8)
        lens = [camera.fx_px, camera.cx_px, camera.cy_px]
        pose = np.concatenate([camera.w2c[:3, :3].ravel(), camera.position, lens])
        trace_room(
            pose, ROOM, LAMP_AT, scene.boxes, scene.fixtures, scene.wall_pictures, scene.seed,
            self._buffer, self._room,
        )  # fmt: skip
        # Directions of each pixel's first ray, a quarter pixel in from its corner.
        rows, columns = np.mgrid[: size[0], : size[1]] + 0.25
        x, y = (columns - camera.cx_px) / camera.fx_px, (rows - camera.cy_px) / camera.fx_px
        directions = np.stack([x, y, np.ones_like(x)], axis=-1)
        self._depth_per_m = (1 / np.linalg.norm(directions, axis=-1)).astype(np.float32)
        self._directions = (directions * self._depth_per_m[..., None]) @ camera.w2c[:3, :3]

    def film(self, frame: int) -> tuple[Picture, Floats]:
        """(picture (h, w, 3), distance (h, w) in metres along each pixel's first ray)."""
        picture = np.empty_like(self._room)
        distance = np.empty(self._room.shape[:2], np.float32)
        moving = self._scene.moving[frame]
        trace_frame(
            self._camera.position, LAMP_AT, moving.parts, moving.groups, self._scene.seed,
            self._buffer, self._room, picture, distance,
        )  # fmt: skip
        return picture, distance

    def depth_range(self, distance: Floats) -> tuple[float, float]:
        """(least, largest) depth of what a frame shows, metres."""
        depth = distance * self._depth_per_m
        return float(depth.min()), float(depth.max())

    def sample_points(
        self, picture: Picture, distance: Floats, count: int, rng: np.random.Generator
    ) -> tuple[Floats, npt.NDArray[np.uint8]]:
        """(xyz (P, 3), rgb (P, 3)) of what randomly chosen pixels show."""
        rows = rng.integers(0, picture.shape[0], count)
        columns = rng.integers(0, picture.shape[1], count)
        offsets = self._directions[rows, columns] * distance[rows, columns, None]
        return (self._camera.position + offsets).astype(np.float32), picture[rows, columns]


def _write_capture(config: SynthConfig, folder: Path, console: Console | None) -> None:
    scene = make_scene(config.frames, config.fps, config.seed, config.walk_radius_m)
    arc_rad = float(np.radians(config.arc_deg))
    cameras = camera_rig(config.cameras, config.width_px, config.height_px, arc_rad)
    held_out = held_out_cameras(cameras, config.held_out)
    training = [camera.name for camera in cameras if camera.name not in held_out]
    per_camera = -(-config.points // len(training))
    total, number = config.frames * config.cameras, count(1)
    with counted("filming", console) as show:

        def film(camera: Camera) -> Take:
            num_points = per_camera if camera.name in training else 0
            try:
                return _film_camera(
                    config, folder, scene, camera, num_points, lambda: show(next(number), total)
                )
            except OSError as error:
                place = config.out / f"{camera.name}.mp4"
                if str(error.filename).startswith("file:"):  # as FFmpeg calls what it writes
                    raise OSError(error.errno, error.strerror, str(place)) from error
                name_file(error, place)
                raise

        # After a failure or an interrupt `map` cancels the cameras that have not begun.
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            takes = list(pool.map(film, cameras))
    rows = [encode_pose(c, t.near_m, t.far_m) for c, t in zip(cameras, takes, strict=True)]
    poses = io.BytesIO()  # of a full disk numpy itself does not tell
    np.save(poses, np.stack(rows))
    (folder / POSES_NAME).write_bytes(poses.getvalue())
    (folder / HELD_OUT_NAME).write_text("".join(f"{name}\n" for name in held_out))
    if config.points:
        xyz = np.concatenate([take.xyz for take in takes])[: config.points]
        rgb = np.concatenate([take.rgb for take in takes])[: config.points]
        np.savez(folder / POINTS_NAME, xyz=xyz, rgb=rgb)


def _film_camera(
    config: SynthConfig,
    folder: Path,
    scene: Scene,
    camera: Camera,
    num_points: int,
    advance: Callable[[], None],
) -> Take:
    """Films one camera into its video."""
    studio = Studio(scene, camera)
    near_m, far_m = np.inf, 0.0
    xyz, rgb = np.empty((0, 3), np.float32), np.empty((0, 3), np.uint8)
    with VideoWriter(folder / f"{camera.name}.mp4", camera, config.fps) as video:
        for frame in range(config.frames):
            picture, distance = studio.film(frame)
            video.write(picture)
            low_m, high_m = studio.depth_range(distance)
            near_m, far_m = min(near_m, low_m), max(far_m, high_m)
            if frame == 0 and num_points:
                rng = np.random.default_rng([config.seed, int(camera.name[3:])])
                xyz, rgb = studio.sample_points(picture, distance, num_points, rng)
            advance()
    return Take(near_m, far_m, xyz, rgb)


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
