"""Cameras in the synthetic room, and what they see."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import numpy.typing as npt

from codec.arrays import Doubles
from codec.camera import Camera, look_at
from trainer.synth.film import Studio, spacing_m
from trainer.synth.scene import UP, WALK_RADIUS_M, Scene, camera_rig

Picture = npt.NDArray[np.uint8]

WIDTH_PX, HEIGHT_PX = SIZE_PX = 128, 72


@cache
def room() -> Scene:
    return Scene(30.0, 0, WALK_RADIUS_M, spacing_m(WIDTH_PX))


def studios(cameras: Sequence[Camera]) -> list[Studio]:
    """The room as each camera sees it, in frame 0 alone."""
    return [Studio(room(), camera) for camera in cameras]


def points_seen(seen: Sequence[Studio], count: int) -> tuple[Doubles, Picture]:
    """(P, 3) points on the surfaces that cameras see, and their colours."""
    found = []
    for number, studio in enumerate(seen):
        rng = np.random.default_rng(number)
        found.append(studio.sample_points(count // len(seen), rng))
    xyz, rgb = zip(*found, strict=True)
    return np.concatenate(xyz).astype(np.float64), np.concatenate(rgb)


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
