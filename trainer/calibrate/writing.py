"""A calibrated rig as a capture of the nerfstudio layout beside its videos or pictures, and the
report on it.
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from codec.arrays import Bytes, Doubles
from codec.camera import Camera
from codec.sequence.survey import FPS_NAME
from trainer.capture.capture import Capture
from trainer.capture.dynerf import POINTS_NAME
from trainer.capture.lens import Lens
from trainer.capture.picturefiles import IMAGES_NAME
from trainer.capture.transforms import START_KEY, TRANSFORMS_NAME
from trainer.capture.video import VIDEOS_NAME

from .mapping import PICTURES_NAME, picture_name
from .offsets import Synchrony
from .rigimport import CalibratedCamera, transforms_entry
from .solution import Rig, Similarity, Solution
from .takes import Take
from .verdicts import Halves

REPORT_NAME = "calibration.txt"

LENS_TEXT = {
    "like": "one for each camera, like those of its kind",
    "free": "one for each camera",
}


def report_lines(
    capture: Capture,
    synchrony: Synchrony,
    halves: Halves,
    names: Sequence[str],
    wrong: Mapping[int, str],
    has_floor: bool,
    has_unit: bool,
) -> list[str]:
    """The report: of the rig, then of each camera. has_floor, has_unit: whether up comes from a
    floor, and the unit from a known distance."""
    right = [i for i in range(len(names)) if i not in wrong]
    table = np.stack([halves.apart, halves.apart_deg, halves.unseen_px])[:, right]
    apart, turned, unseen = table
    rate = "" if synchrony.fps is None else f" at {synchrony.fps:g} per second"
    unit = "metres" if has_unit else "unknown: cameras are some 3 units from the middle (--metres)"
    lines = [
        f"capture     {capture.root}",
        f"cameras     {len(right)} of {len(names)}",
        f"frames      {capture.num_frames}{rate}, synchronised {synchrony.how}",
        f"lenses      {LENS_TEXT[halves.lens]}",
        f"halves      of the take place cameras {np.median(apart):.2%} of their distance to the "
        f"scene ({apart.max():.2%} at most) and {np.median(turned):.2f} degrees "
        f"({turned.max():.2f}) apart; the whole is better than its halves",
        f"unseen      moments are missed by {np.median(unseen):.2f} px ({unseen.max():.2f})",
        f"up          z, {'from the floor' if has_floor else 'as the cameras are held'}",
        f"unit        {unit}",
        *(f"note        {note}" for note in synchrony.notes),
        *(f"left out    {names[i]} {reason}" for i, reason in wrong.items()),
        "",
        f"{'camera':16} {'from origin':>11} {'focal px':>9} {'apart':>7} {'degrees':>7} {'px':>6}",
    ]
    for entry, (apart, turned, unseen) in zip(capture.cameras, table.T, strict=True):
        camera = entry.camera
        lines.append(
            f"{camera.name:16} {np.linalg.norm(camera.position):11.2f} {camera.fx_px:9.1f} "
            f"{apart:7.2%} {turned:7.2f} {unseen:6.2f}"
        )
    return lines


def calibrated(
    rig: Rig, takes: Sequence[Take], sizes_px: Sequence[tuple[int, int]], right: Sequence[int]
) -> list[CalibratedCamera]:
    """The cameras of a rig at the full size of their pictures. sizes_px: those it was made of."""
    found = []
    for index in right:
        focal_px, cx_px, cy_px, k1 = map(float, rig.lenses[index])
        size = sizes_px[index]
        w2c = np.vstack([rig.poses[index], [0, 0, 0, 1]])
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
            last = picture.shape[1] - 1, picture.shape[0] - 1
            columns, rows = np.clip(keypoints[at, :2].astype(int), 0, last).T
            np.add.at(total, mine[at, 0], picture[rows, columns])
            np.add.at(count, mine[at, 0], 1)
    kept = count >= 2
    rgb = np.rint(total[kept] / count[kept, None]).astype(np.uint8)
    return world.points(rig.points[kept]), rgb
