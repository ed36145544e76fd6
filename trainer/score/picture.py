"""How a picture of Gaussians scores against what a camera saw."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from codec.arrays import Floats
from codec.camera import Camera
from codec.splats import Splats
from player.render.cpu import render_splats
from trainer.capture.capture import Mask, Picture
from trainer.pictures.shot import Shot
from trainer.step.loss import psnr_db, ssim


@dataclass(frozen=True, slots=True)
class Score:
    """How well one picture is rendered; NaN where none of its pixels counts."""

    psnr_db: float
    ssim: float


def captured(picture: Picture) -> Floats:
    """A camera's (H, W, 3) uint8 picture as floats in 0..1."""
    floats: Floats = picture.astype(np.float32) / np.float32(255)
    return floats


def displayed(splats: Splats, camera: Camera, near_m: float) -> Floats:
    """(H, W, 3) in 0..1: what a screen shows of `splats`."""
    return on_screen(render_splats(splats, camera, near_m))


def on_screen(picture: Floats) -> Floats:
    """`picture` in 0..1, rounded to the 8 bits of a screen."""
    shown: Floats = np.rint(np.clip(picture, 0, 1) * np.float32(255)) / np.float32(255)
    return shown


def score_picture(shown: Floats, truth: Floats, mask: Mask | None) -> Score:
    """Both pictures in 0..1, compared where the mask counts."""
    return Score(psnr_db(shown, truth, mask), ssim(shown, truth, mask))


def score_splats(splats: Splats, camera: Camera, shot: Shot, near_m: float) -> Score:
    """How `splats` look from `camera` against what it saw."""
    return score_picture(displayed(splats, camera, near_m), captured(shot.picture), shot.mask)
