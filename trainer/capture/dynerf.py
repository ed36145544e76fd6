"""The DyNeRF layout (Neural 3D Video): one video per camera and the poses in an LLFF file.

    camNN.mp4          a video per camera, in order of file name; also .MP4
    poses_bounds.npy   (V, 17) float64, one row per video, see `decode_pose`
    held_out.txt       optional, see capture.py
    points.npz         optional initial points in the poses' world, see points.py
    masks/             optional, see masks.py

All videos have the same number of frames; the frame rate is that of their containers. They may be
smaller than the poses declare, all by one factor, as in the usual copy of that data set. The unit
of the poses is taken as a metre. The layout cannot describe lens distortion, so the videos must be
undistorted already.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from codec.arrays import Doubles
from codec.camera import Camera, world_to_camera
from codec.errors import InvalidError
from codec.rig import rig_depths
from trainer.errors import CaptureError

from .capture import ALL_CAMERAS, CameraChoice, Capture, CaptureCamera, PictureSource, read_held_out
from .lens import Lens, check_optics
from .masks import folder_masks
from .points import read_points
from .synchrony import check_synchronised
from .video import VideoFacts, VideoSource, check_video_size, probe_video

POSES_NAME = "poses_bounds.npy"
POINTS_NAME = "points.npz"
VIDEO_PATTERN = re.compile(r"cam\d+\.mp4", re.IGNORECASE)

_LLFF_FROM_OPENCV = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
"""Camera axes: (down, right, backwards) = M (right, down, forward). M is symmetric and its own
inverse."""


def open_dynerf(root: Path, choice: CameraChoice = ALL_CAMERAS) -> Capture:
    """The chosen cameras of the capture in a folder of this layout. Raises CaptureError."""
    videos = sorted(path for path in root.iterdir() if VIDEO_PATTERN.fullmatch(path.name))
    if not videos:
        raise CaptureError(f"{root}: has {POSES_NAME} but no camNN.mp4")
    rows = read_poses_bounds(root / POSES_NAME)
    if len(rows) != len(videos):
        raise CaptureError(
            f"{root / POSES_NAME}: {len(rows)} poses for {len(videos)} videos; "
            "there must be one row per camNN.mp4"
        )
    kept = choice.keep([path.stem for path in videos], root)
    rows = rows[[path.stem in kept for path in videos]]
    videos = [path for path in videos if path.stem in kept]
    facts = [probe_video(path) for path in videos]
    check_synchronised(videos, facts)
    declared = [
        decode_pose(row, path.stem, root / POSES_NAME)
        for row, path in zip(rows, videos, strict=True)
    ]
    cameras = _at_one_scale(declared, facts)
    for path, fact, camera in zip(videos, facts, cameras, strict=True):
        check_video_size(path, fact, camera, root / POSES_NAME)
    held_out = read_held_out(root, cameras, choice)
    depths = rig_depths(cameras, (float(rows[:, 15].min()), float(rows[:, 16].max())))
    num_frames = facts[0].num_frames

    def open_images(camera_index: int) -> PictureSource:
        return VideoSource(videos[camera_index], cameras[camera_index], num_frames)

    masks = folder_masks(root, cameras, [Lens()] * len(cameras), num_frames, choice)
    return Capture(
        root=root,
        layout="dynerf",
        cameras=tuple(
            CaptureCamera(camera, camera.name in held_out, mask)
            for camera, mask in zip(cameras, masks, strict=True)
        ),
        num_frames=num_frames,
        fps=facts[0].fps,
        points=read_points(root / POINTS_NAME) if (root / POINTS_NAME).is_file() else None,
        near_m=depths[0] if depths else None,
        far_m=depths[1] if depths else None,
        opener=open_images,
        videos=tuple(videos),
        doubts=() if cameras == declared else (_scale_doubt(cameras[0], declared[0]),),
    )


def _at_one_scale(declared: Sequence[Camera], facts: Sequence[VideoFacts]) -> list[Camera]:
    """The cameras at the sizes of their videos, if all are smaller than declared by one factor in
    both sides; else the cameras as declared."""
    scale = facts[0].width_px / declared[0].width_px
    for camera, fact in zip(declared, facts, strict=True):
        for side_px, declared_px in (
            (fact.width_px, camera.width_px),
            (fact.height_px, camera.height_px),
        ):
            if scale >= 1 or abs(side_px - scale * declared_px) > 1:
                return list(declared)
    return [c.resized(f.width_px, f.height_px) for c, f in zip(declared, facts, strict=True)]


def _scale_doubt(read: Camera, declared: Camera) -> str:
    return (
        f"smaller videos: {read.width_px}x{read.height_px} px, where {POSES_NAME} declares "
        f"{declared.width_px}x{declared.height_px}; its intrinsics are scaled by "
        f"{read.width_px / declared.width_px:.3g}"
    )


def read_poses_bounds(path: Path) -> Doubles:
    """(V, 17) the rows of a poses_bounds.npy. Raises CaptureError."""
    if not path.is_file():
        raise CaptureError(f"{path}: is not a file; it holds the cameras' poses")
    try:
        # Mapped: what its header claims to hold must be there.
        rows = np.load(path, mmap_mode="r", allow_pickle=False)
    except (OSError, ValueError, EOFError, TypeError, SyntaxError) as error:
        raise CaptureError(f"{path}: not a .npy file of numbers: {error}") from error
    if not isinstance(rows, np.ndarray) or rows.ndim != 2 or rows.shape[1] != 17:
        raise CaptureError(f"{path}: has shape {getattr(rows, 'shape', None)}, not (cameras, 17)")
    if rows.dtype.kind not in "fiu" or not np.isfinite(rows).all():
        raise CaptureError(f"{path}: holds values that are not finite numbers")
    if not ((rows[:, 15] > 0) & (rows[:, 16] > rows[:, 15])).all():
        raise CaptureError(f"{path}: the last two columns of a row are not 0 < near < far")
    return rows.astype(np.float64)


def decode_pose(row: Doubles, name: str, path: Path) -> Camera:
    """The camera of one row of poses_bounds.npy. Raises CaptureError, naming `path`.

    Columns 0..14 are a 3x5 matrix, row by row: [R | t | (H, W, f)]. [R | t] is camera to world, t
    the centre, f the focal length in pixels. The columns of R are the camera's axes down, right,
    backwards in the world. OpenCV's are right, down, forward, so with M the matrix above R_cv = R M
    (swap the first two columns, negate the third), and the pose is w2c = [R_cv^T | -R_cv^T t]. The
    principal point is the middle of the picture, W/2, H/2, where the first pixel's centre is (0.5,
    0.5).
    """
    matrix = row[:15].reshape(3, 5)
    height, width, focal = matrix[:, 4]
    if width != int(width) or height != int(height):
        raise CaptureError(f"{path}: {name}: size {width:g}x{height:g} px is not whole")
    rotation = matrix[:, :3] @ _LLFF_FROM_OPENCV
    w2c = world_to_camera(rotation.T, matrix[:, 3])
    try:
        camera = Camera(name, int(width), int(height), focal, focal, width / 2, height / 2, w2c)
    except InvalidError as error:
        raise CaptureError(f"{path}: {error}") from error
    check_optics(camera, Lens(), path)
    return camera


def encode_pose(camera: Camera, near_m: float, far_m: float) -> Doubles:
    """(17,) the row that `decode_pose` reads.

    Raises InvalidError for a camera that the row cannot describe: unequal focal lengths, or a
    principal point off the middle.
    """
    middle = (camera.width_px / 2, camera.height_px / 2)
    if camera.fx_px != camera.fy_px or (camera.cx_px, camera.cy_px) != middle:
        raise InvalidError(
            f"camera {camera.name}: LLFF poses hold one focal length and no principal point"
        )
    rotation = camera.w2c[:3, :3].T @ _LLFF_FROM_OPENCV
    size = np.array([camera.height_px, camera.width_px, camera.fx_px])
    matrix = np.column_stack([rotation, camera.position, size])
    return np.concatenate([matrix.ravel(), [near_m, far_m]])
