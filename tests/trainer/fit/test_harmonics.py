"""Training with spherical harmonics learns view-dependent colours."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from codec.splats import Splats
from player.render.cpu import render_splats
from trainer.fit.trainer import Trainer
from trainer.pictures.shot import Shot
from trainer.step.loss import psnr_db

from .test_trainer import CONFIG, NEAR_M, Rendered, truth


def shimmering(frame: int) -> Splats:
    """The blobs of `truth` with strong harmonics of degree 2 and 3."""
    splats = truth(frame).with_degree(3)
    splats.sh[:, 4:] = np.random.default_rng(9).normal(0, 0.5, (len(splats), 12, 3))
    return splats


class Shimmering(Rendered):
    """Pictures of these blobs."""

    def picture(self, camera: int, frame: int) -> np.ndarray:
        return np.clip(render_splats(shimmering(frame), self.cameras[camera], NEAR_M), 0, 1)

    def shot(self, camera: int, frame: int) -> Shot:
        return Shot(np.rint(self.picture(camera, frame) * 255).astype(np.uint8), None)


def reached_db(sh_degree: int) -> float:
    """Mean PSNR of the training cameras in frame 0, starting from the blobs without harmonics."""
    config = replace(CONFIG, num_gs=40, swin_size=1, sh_degree=sh_degree)
    # Rates at which few iterations suffice.
    optimiser = replace(config.optimiser, sh_lr=0.1)
    config = replace(config, genesis_iterations=200, coarse_share=0.0, optimiser=optimiser)
    pictures = Shimmering()
    trainer = Trainer(config, pictures, truth(0).with_degree(sh_degree), NEAR_M)
    next(iter(trainer.windows()))
    shown, scores_db = trainer.shown(0), []
    assert shown.sh_degree == sh_degree
    for number, camera in enumerate(pictures.cameras):
        picture = np.clip(render_splats(shown, camera, NEAR_M), 0, 1)
        scores_db.append(psnr_db(picture, pictures.picture(number, 0)))
    return float(np.mean(scores_db))


def test_colours_follow_the_viewer() -> None:
    assert reached_db(3) > reached_db(1) + 6
