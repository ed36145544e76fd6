"""A calibrated rig as a capture of the nerfstudio layout, beside its videos or pictures."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from codec.arrays import Bytes, Doubles
from codec.camera import Camera
from codec.sequence.numberedfiles import FPS_NAME
from trainer.calibration.calibration import CalibratedCamera
from trainer.calibration.rigimport import transforms_entry
from trainer.capture.dynerf import POINTS_NAME
from trainer.capture.lens import Lens
from trainer.capture.picturefiles import IMAGES_NAME
from trainer.capture.transforms import START_KEY, TRANSFORMS_NAME

from .alignment import Similarity
from .mapping import PICTURES_NAME, picture_name
from .offsets import Synchrony
from .solution import Rig, Solution
from .takes import Take

VIDEOS_NAME = "videos"


def calibrated(
    rig: Rig, takes: Sequence[Take], sizes_px: Sequence[tuple[int, int]], right: Sequence[int]
) -> list[CalibratedCamera]:
    """The cameras of a rig at the full size of their pictures. sizes_px: those it was made of."""
    found = []
    for index in right:
        focal_px, cx_px, cy_px, k1 = map(float, rig.lenses[index])
        size = sizes_px[index]
        w2c = np.vstack([rig.poses[index], [0, 0, 0, 1]])
        # Rotations are orthonormal to rounding only.
        u, _, vt = np.linalg.svd(w2c[:3, :3])
        w2c[:3, :3] = u @ vt
        take = takes[index]
        camera = Camera(take.name, *size, focal_px, focal_px, cx_px, cy_px, w2c)
        full = camera.resized(take.width_px, take.height_px)
        found.append(CalibratedCamera(full, Lens(k1=k1)))
    return found


def write_capture(
    folder: Path,
    cameras: Sequence[CalibratedCamera],
    takes: Sequence[Take],
    synchrony: Synchrony,
    points: tuple[Doubles, Bytes],
) -> None:
    """Writes transforms.json, points, and links to the videos or pictures. synchrony: of these
    cameras."""
    fps = synchrony.fps
    entries: list[dict[str, Any]] = []
    for each, take, start_s in zip(cameras, takes, synchrony.starts_s, strict=True):
        if take.is_video:
            (folder / VIDEOS_NAME).mkdir(exist_ok=True)
            place = f"{VIDEOS_NAME}/{take.name}{take.files[0].suffix}"
            _link(take.files[0], folder / place)
            entries.append(transforms_entry(each, place) | {START_KEY: round(start_s, 6)})
            continue
        pictures = folder / IMAGES_NAME / take.name
        pictures.mkdir(parents=True)
        first = take.nearest_frame(start_s)
        for number, file in enumerate(take.files[first : first + synchrony.num_frames]):
            _link(file, pictures / f"{number:06d}{file.suffix}")
        place = f"{IMAGES_NAME}/{take.name}/000000{take.files[first].suffix}"
        entries.append(transforms_entry(each, place))
    value: dict[str, Any] = {"camera_model": "OPENCV", "frames": entries}
    if takes[0].is_video:
        value["fps"] = fps
    elif fps is not None:
        (folder / FPS_NAME).write_text(f"{fps:g}\n")
    (folder / TRANSFORMS_NAME).write_text(json.dumps(value, indent=1))
    xyz, rgb = points
    np.savez(folder / POINTS_NAME, xyz=xyz.astype(np.float32), rgb=rgb)


def _link(file: Path, place: Path) -> None:
    """Puts a file at a place without a second copy of its bytes, if the disk can."""
    try:
        os.link(file.resolve(), place)
    except OSError:  # another disk, or one without links
        shutil.copyfile(file, place)


def coloured_points(
    rig: Rig, solution: Solution, world: Similarity, right: Sequence[int], folder: Path
) -> tuple[Doubles, Bytes]:
    """((P, 3) places in the world, (P, 3) colours) of the rig's points that the right cameras see,
    each in its own moment. folder: with the moments' pictures."""
    total = np.zeros((len(rig.points), 3))
    count = np.zeros(len(rig.points))
    for camera in right:
        mine = rig.seen[rig.seen[:, 1] == camera]
        keypoints = solution.keypoints[camera][mine[:, 2]]
        for moment in np.unique(keypoints[:, 2].astype(int)):
            at = keypoints[:, 2] == moment
            name = picture_name(int(moment), camera)
            picture = np.asarray(Image.open(folder / PICTURES_NAME / name).convert("RGB"))
            height, width = picture.shape[:2]
            columns = np.clip(keypoints[at, 0].astype(int), 0, width - 1)
            rows = np.clip(keypoints[at, 1].astype(int), 0, height - 1)
            np.add.at(total, mine[at, 0], picture[rows, columns])
            np.add.at(count, mine[at, 0], 1)
    kept = count >= 2
    rgb = np.rint(total[kept] / count[kept, None]).astype(np.uint8)
    return world.points(rig.points[kept]), rgb
