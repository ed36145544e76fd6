"""Scene flow: moving Gaussians are found at their new places, and others are unchanged."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from codec.lattice.lattice import Lattice
from codec.slots.slotlayout import SlotLayout
from codec.splats import Splats
from trainer.fit.config import FitConfig
from trainer.fit.mcmc import McmcConfig
from trainer.fit.renew import Comparer
from trainer.fit.sceneflow import scene_flow
from trainer.fit.trainer import Trainer
from trainer.lease.leases import LeaseConfig
from trainer.step.colour import CameraColour
from trainer.step.raster import View

from .test_renew import NEAR_M, NEW_AT_M, NEW_RADIUS_M, Film, parameters, room, thing

Floats = npt.NDArray[np.float32]


def flow(
    motion_m: Floats, guess_m: float = 0.0, gains: npt.NDArray[np.floating] | None = None
) -> tuple[Floats, npt.NDArray[np.bool_]]:
    """(M, 3) flow of a room in which a thing moves, and (M,) whether a Gaussian is of the thing."""
    before = Splats.concatenate([room(), thing()])
    after = Splats.concatenate([room(), thing(NEW_AT_M + motion_m)])
    is_thing = np.arange(len(before)) >= len(room())
    film = Film([before, after], gains)
    rows = np.arange(len(before), dtype=np.int32)
    colour = CameraColour(len(film.cameras), 0)
    values = parameters(before)
    compared, _, _ = Comparer(
        [View.prepare(c, NEAR_M) for c in film.cameras], for_flow=True
    ).compare(values, rows, film, 1, colour, 0)
    guesses = np.full_like(before.means, guess_m)
    return scene_flow(compared, before.means, guesses, np.random.default_rng(0)), is_thing


@pytest.mark.parametrize("motion_m", [(0.3, 0, 0), (0.0, -0.2, 0.1), (0.05, 0.05, -0.05)])
def test_a_thing_is_found_where_it_went_and_the_room_stays(
    motion_m: tuple[float, float, float],
) -> None:
    moved = np.array(motion_m, np.float32)
    motions, is_thing = flow(moved)
    errors_m = np.linalg.norm(motions[is_thing] - moved, axis=1)
    assert np.median(errors_m) < 0.02
    assert np.mean(errors_m < 0.04) > 0.8
    assert np.mean((motions[~is_thing] == 0).all(axis=1)) > 0.97


@pytest.mark.parametrize("guess_m", [0.0, 0.1])
def test_nothing_moves_where_nothing_changed(guess_m: float) -> None:
    motions, _ = flow(np.zeros(3, np.float32), guess_m)
    assert not motions.any()


@pytest.mark.parametrize("scene_flow", [False, True])
def test_a_window_begins_where_things_went(scene_flow: bool) -> None:
    moved = np.array([0.3, 0, 0], np.float32)
    before = Splats.concatenate([room(), thing()])
    film = Film([before, Splats.concatenate([room(), thing(NEW_AT_M + moved)])])
    config = FitConfig(
        num_gs=len(before),
        genesis_iterations=0,
        settle_rounds=1,
        settle_renew_share=0,
        window_iterations=1,
        scene_flow=scene_flow,
        mcmc=McmcConfig(renew_share=0, noise_lr=0, window_noise_lr=0),
        lease=LeaseConfig(active_share=0.5, trade_share=0),
    )
    layout = SlotLayout(1, (len(before),), 0, (Lattice.suiting(before),), 15)
    trainer = Trainer(config, film, before, NEAR_M, layout=layout)
    for _ in trainer.windows():
        pass
    apart_m = np.linalg.norm(trainer.shown(1).means - NEW_AT_M - moved, axis=1)
    at_new_place = (apart_m < 1.3 * NEW_RADIUS_M).sum()
    assert at_new_place > 32 if scene_flow else at_new_place < 8  # of 40
