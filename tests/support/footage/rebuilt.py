"""Captures as users record them, filmed in the synthetic room."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import numpy.typing as npt

from codec.camera import Camera
from codec.pose import Doubles, look_at, world_to_camera
from tests.support.tiny_models import write_model, write_pictures
from trainer.capture.lens import Lens
from trainer.synth.film import Scene, Studio, make_scene
from trainer.synth.scene import UP, camera_rig

Picture = npt.NDArray[np.uint8]

WIDTH_PX, HEIGHT_PX = SIZE_PX = 128, 72
FINER = 3
"""Scale at which distorted pictures are filmed before they are reduced."""


@dataclass(frozen=True)
class Footage:
    """The true cameras and pictures of a capture."""

    cameras: list[Camera]
    """The cameras as the capture describes them."""
    pictures: list[list[Picture]]
    """Pictures of pinhole cameras, by camera and frame."""


@cache
def room() -> Scene:
    return make_scene(2, 30.0, 0)


def filmed(camera: Camera) -> list[Picture]:
    """The picture of each frame, of which there is one."""
    return [Studio(room(), camera).film(0)[0]]


def points_seen(cameras: Sequence[Camera], count: int) -> tuple[Doubles, Picture]:
    """(P, 3) points on the surfaces that the cameras see in frame 0, and their colours."""
    found = []
    for number, camera in enumerate(cameras):
        studio = Studio(room(), camera)
        rng = np.random.default_rng(number)
        found.append(studio.sample_points(*studio.film(0), count // len(cameras), rng))
    xyz, rgb = zip(*found, strict=True)
    return np.concatenate(xyz).astype(np.float64), np.concatenate(rgb)


def straight_place(bent: Doubles, lens: Lens) -> Doubles:
    """(..., 2) undistorted places on the picture plane of the places `bent` under a lens."""
    x, y = straight = np.moveaxis(bent, -1, 0).copy()
    for _ in range(50):
        r2 = x * x + y * y
        radial = 1 + r2 * (lens.k1 + r2 * (lens.k2 + r2 * lens.k3))
        off = [
            2 * lens.p1 * x * y + lens.p2 * (r2 + 2 * x * x),
            2 * lens.p2 * x * y + lens.p1 * (r2 + 2 * y * y),
        ]
        x, y = straight = (np.moveaxis(bent, -1, 0) - off) / radial
    return np.moveaxis(straight, 0, -1)


def distorted(camera: Camera, lens: Lens) -> Picture:
    """The camera's picture through the lens: that of a finer and wider pinhole, distorted."""
    wide = replace(
        camera, width_px=int(1.3 * FINER * camera.width_px), fx_px=FINER * camera.fx_px,
        height_px=int(1.3 * FINER * camera.height_px), fy_px=FINER * camera.fy_px,
        cx_px=FINER * (camera.cx_px + 0.15 * camera.width_px),
        cy_px=FINER * (camera.cy_px + 0.15 * camera.height_px),
    )  # fmt: skip
    # FINER x FINER samples in each pixel, so that it is as soft as an undistorted picture.
    v, u = (np.mgrid[: FINER * camera.height_px, : FINER * camera.width_px] + 0.5) / FINER
    bent = np.stack([(u - camera.cx_px) / camera.fx_px, (v - camera.cy_px) / camera.fy_px], axis=-1)
    places = straight_place(bent, lens)
    columns = np.clip((places[..., 0] * wide.fx_px + wide.cx_px).astype(int), 0, wide.width_px - 1)
    rows = np.clip((places[..., 1] * wide.fy_px + wide.cy_px).astype(int), 0, wide.height_px - 1)
    shape = camera.height_px, FINER, camera.width_px, FINER, 3
    (picture,) = filmed(wide)
    mean = picture[rows, columns].reshape(shape).mean(axis=(1, 3))
    bent_picture: Picture = np.rint(mean).astype(np.uint8)
    return bent_picture


def write_radial(root: Path) -> Footage:
    """COLMAP in text, without a rate: lenses with radial and tangential distortion, a camera of
    another size, a world that is scaled, turned and moved."""
    lens, scale = Lens(k1=-0.12, k2=0.03, p1=0.002, p2=-0.0015), 0.37
    turn = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    offset = np.array([2.0, -5.0, 0.5])
    cameras = camera_rig(9, WIDTH_PX, HEIGHT_PX, float(np.radians(200)))
    cameras[7] = cameras[7].scaled(0.75)
    xyz, rgb = points_seen(cameras, 4000)
    xyz = scale * xyz @ turn.T + offset
    placed = [
        replace(c, w2c=world_to_camera(c.w2c[:3, :3] @ turn.T, scale * turn @ c.position + offset))
        for c in cameras
    ]
    write_pictures(root, cameras, 1, False, lambda i, _: distorted(cameras[i], lens))
    folder, names = root / "sparse/0", [f"{camera.name}/0007.png" for camera in cameras]
    terms = lens.k1, lens.k2, lens.p1, lens.p2
    write_model(folder, placed, names, False, "OPENCV", terms)
    marks = ["# 3D point list"]
    for number, (place, colour) in enumerate(zip(xyz.tolist(), rgb.tolist(), strict=True), 1):
        marks.append(" ".join(map(str, (number, *place, *colour, 0.5, 1, 0, 2, 0))))
    (folder / "points3D.txt").write_text("\n".join(marks) + "\n")
    return Footage(placed, [filmed(camera) for camera in cameras])


def close_rig(num_cameras: int = 12) -> list[Camera]:
    """Cameras around the sofa; the outermost ones almost touch its arms."""
    cameras = camera_rig(num_cameras, WIDTH_PX, HEIGHT_PX, 0.0)
    target = np.array([-0.75, -0.45, 2.8])
    for i, camera in enumerate(cameras):
        angle = np.pi * (i / (num_cameras - 1) - 0.5)
        place = target + 1.5 * np.array([-np.sin(angle), 0.0, -np.cos(angle)])
        place[1] = -(0.75, 1.15)[i % 2]
        cameras[i] = replace(camera, w2c=look_at(place, target, UP))
    return cameras
