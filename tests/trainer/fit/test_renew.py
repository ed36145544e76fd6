"""Renewal places Gaussians on objects that none renders; scene flow follows things."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import numpy.typing as npt
import pytest

from codec.arrays import Bytes, Flags, Floats
from codec.camera import Camera
from codec.lattice.lattice import Lattice
from codec.slots.slotlayout import SlotLayout
from codec.splats import Splats
from player.render.cpu import render_splats
from tests.support.tiny_capture import tiny_rig
from trainer.capture.capture import Mask
from trainer.fit.config import FitConfig
from trainer.fit.leasedslots import LeasedSlots
from trainer.fit.mcmc import McmcConfig
from trainer.fit.renew import Comparer, Comparison, missing_splats
from trainer.fit.sceneflow import scene_flow as flow_of
from trainer.fit.trainer import Trainer
from trainer.lease.leases import LeaseConfig
from trainer.pictures.scale import Shot
from trainer.seed.gaussians import initial_splats
from trainer.step.colour import CameraColour
from trainer.step.raster import Parameters, View
from trainer.synth.scene import CAMERA_RADIUS_M

NEAR_M, FAR_M = 0.5, 20.0
NEW_AT_M = np.array([0.4, -0.9, 0.3], np.float32)
NEW_RADIUS_M = 0.15
NEW_COLOUR = (230, 40, 30)
Sizes = Sequence[tuple[int, int]]


def blobs(points: npt.NDArray[np.floating], colours: Bytes, radius: float) -> Splats:
    splats = initial_splats(points.astype(np.float32), colours, 0)
    splats.log_scales[:] = np.log(radius)
    splats.logit_opacities[:] = 4
    return splats


def room() -> Splats:
    """A wall of coloured blobs behind the middle of the rig."""
    rng = np.random.default_rng(2)
    points = rng.uniform([-2.5, -2.5, 1.5], [2.5, 0.5, 2.5], (250, 3))
    return blobs(points, rng.integers(40, 200, (250, 3), dtype=np.uint8), 0.15)


def thing(at: npt.NDArray[np.floating] = NEW_AT_M) -> Splats:
    """A red ball of blobs in different reds."""
    rng = np.random.default_rng(4)
    inside = rng.normal(size=(40, 3))
    inside *= NEW_RADIUS_M / np.linalg.norm(inside, axis=1, keepdims=True)
    colours = np.clip(np.array(NEW_COLOUR) + rng.integers(-60, 25, (40, 1)), 0, 255)
    return blobs(at + inside, colours.astype(np.uint8), 0.05)


def seen(splats: Splats, camera: Camera, gain: float) -> Bytes:
    picture = np.clip(gain * render_splats(splats, camera, NEAR_M), 0, 1)
    rounded: Bytes = np.rint(picture * 255).astype(np.uint8)
    return rounded


class Film:
    """Pictures of the Gaussians of each frame."""

    def __init__(
        self, frames: list[Splats], gains: Iterable[float] = (1,) * 8, sizes: Sizes = ((160, 90),)
    ) -> None:
        rig = tiny_rig(8, arc_deg=90.0)
        self.cameras = [c.resized(*sizes[i % len(sizes)]) for i, c in enumerate(rig)]
        self.num_frames = len(frames)
        self._pictures = [
            [seen(splats, camera, gain) for camera, gain in zip(self.cameras, gains, strict=True)]
            for splats in frames
        ]
        self.masks: list[Mask | None] = [None] * 8

    def shot(self, camera: int, frame: int) -> Shot:
        return Shot(self._pictures[frame][camera], self.masks[camera])

    def mask(self, camera: int, frame: int) -> Mask | None:
        return self.masks[camera]


def compare(film: Film, splats: Splats, colour: CameraColour | None = None) -> Comparison:
    """Comparison of the film's first frame with `splats`."""
    colour = colour or CameraColour(len(film.cameras), 0)
    rows = np.arange(len(splats), dtype=np.int32)
    comparer = Comparer([View.prepare(c, NEAR_M) for c in film.cameras], film, colour)
    return comparer.compare(Parameters(*splats.arrays), rows, 0)[0]


def find(compared: Comparison, count: int = 200) -> Splats:
    return missing_splats(compared, count, NEAR_M, FAR_M, 0, np.random.default_rng(0))


@pytest.mark.parametrize(
    ("sizes", "masked"), [([(160, 90), (128, 100), (400, 225)], ()), ([(160, 90)], (0, 2, 4, 5, 7))]
)
def test_missing_things_are_found_in_place_and_colour(sizes: Sizes, masked: Sequence[int]) -> None:
    film = Film([Splats.concatenate([room(), thing()])], sizes=sizes)
    for i in masked:
        film.masks[i] = np.zeros((90, 160), np.uint8)
    found = find(compare(film, room()))
    assert 100 < len(found) <= 200
    off = np.linalg.norm(found.means - NEW_AT_M, axis=1)
    assert np.median(off) < 1.3 * NEW_RADIUS_M
    assert np.mean(off < 2 * NEW_RADIUS_M) > 0.9
    colours = 0.5 + 0.2820948 * found.sh[:, 0]
    np.testing.assert_allclose(np.median(colours, axis=0) * 255, np.array(NEW_COLOUR) - 20, atol=35)
    assert np.exp(found.log_scales).max() < NEW_RADIUS_M


def test_nothing_is_found_where_all_is_rendered_or_one_camera_alone_differs() -> None:
    film = Film([room()])
    assert len(find(compare(film, room()))) == 0
    film.shot(3, 0).picture[20:40, 50:90] = 255
    assert len(find(compare(film, room()))) == 0
    assert len(find(compare(film, room()), count=0)) == 0


def test_a_cameras_own_colour_is_not_an_error_and_masked_pixels_do_not_count() -> None:
    gains = np.linspace(0.7, 1.0, 8)
    film = Film([room()], gains)
    colour = CameraColour(8, 0)
    assert compare(film, room(), colour).errors.max() > 0.08
    colour.values[:, :3] = gains[:, None]
    assert compare(film, room(), colour).errors.max() < 0.02
    film.shot(2, 0).picture[10:30, 10:30] = 255
    mask = np.ones((90, 160), np.uint8)
    mask[10:30, 10:30] = 0
    film.masks[2] = mask
    compared = compare(film, room(), colour)
    assert (compared.errors * compared.usable).max() < 0.02
    assert not compared.usable[2, 9:31, 9:31].any()
    assert compared.usable[2, 32:88, 32:158].all()


def test_what_a_camera_cannot_show_is_not_an_error() -> None:
    bright = room()
    bright.sh[:] += 1.5
    film = Film([bright], np.linspace(0.6, 1.0, 8))
    assert film.shot(7, 0).picture.max() == 255
    colour = CameraColour(8, 0)
    colour.values[:, :3] = np.linspace(0.6, 1.0, 8)[:, None]
    assert compare(film, bright, colour).errors.max() < 0.02
    assert len(find(compare(film, bright, colour))) == 0


def test_few_wrong_pixels_give_few_gaussians_each_in_a_place_of_its_own() -> None:
    speck = blobs(NEW_AT_M[None], np.array([NEW_COLOUR], np.uint8), 0.02)
    compared = compare(Film([Splats.concatenate([room(), speck])]), room())
    wrong = int((compared.usable & (compared.errors >= 0.05)).sum())
    assert 8 <= wrong < 200
    found = find(compared, count=2000)
    assert 0 < len(found) <= wrong
    assert len(np.unique(found.means, axis=0)) == len(found)
    pixel_m = CAMERA_RADIUS_M / compared.cameras[0].fx_px
    assert np.exp(found.log_scales).min() > 0.2 * pixel_m


def test_nothing_is_placed_outside_the_depths_of_the_scene() -> None:
    away = thing(np.array([0.2, -0.9, 14.0]))
    away.log_scales[:] = np.log(0.6)
    compared = compare(Film([Splats.concatenate([room(), away])]), room())
    found = missing_splats(compared, 200, 1.0, 6.0, 0, np.random.default_rng(0))
    depths = [found.means @ c.w2c[2, :3] + c.w2c[2, 3] for c in compared.cameras]
    assert np.max(depths, initial=0) < 12
    assert (np.min(depths, axis=0) < 6.001).all()


CONFIG = FitConfig(
    num_gs=300, swin_size=3, genesis_iterations=100, settle_rounds=0, window_iterations=20,
    mcmc=McmcConfig(renew_share=0.2),
)  # fmt: skip


def before_the_jump() -> Splats:
    black = blobs(room().means[:10], np.zeros((10, 3), np.uint8), 0.01)
    return Splats.concatenate([room(), thing(), black])


def test_what_jumps_is_followed() -> None:
    """The ball stands still for four frames and then jumps by a metre."""
    far = NEW_AT_M + np.array([-1.0, 0.1, 0.2], np.float32)
    places, errors = [NEW_AT_M] * 4 + [far] * 2, []
    film = Film([Splats.concatenate([room(), thing(at)]) for at in places])
    for share in (0.0, 0.2):
        config = replace(CONFIG, mcmc=replace(CONFIG.mcmc, renew_share=share))
        trainer = Trainer(config, film, before_the_jump(), NEAR_M, FAR_M)
        for window in trainer.windows():
            if window.first_frame == 2:  # it shows frames 2, 3 and, for the first time, 4
                break
        shown = render_splats(trainer.shown(4), film.cameras[4], NEAR_M)
        errors.append(float(np.square(shown - film.shot(4, 4).picture / 255).mean()))
    assert errors[1] < 0.5 * errors[0]


def test_only_the_least_of_each_slice_are_placed_and_show_from_the_frame_on() -> None:
    film, rng, frame = Film([room()] * 6), np.random.default_rng(0), 4
    strategy = Trainer(CONFIG, film, before_the_jump(), NEAR_M, FAR_M).strategy
    generations = strategy.fit.generations
    for first_frame in (0, 1):
        strategy.mature(range(first_frame, first_frame + 3))
    lifespans, num_gs = generations.lifespans, CONFIG.num_gs
    before = [array.copy() for array in generations.values.arrays]
    starts, rows = lifespans.starts.copy(), lifespans.active_rows(frame)
    weights = rng.random(len(rows), np.float32)
    least = generations.least(rows, weights, round(0.2 * lifespans.slice_size))
    renewed = least[: len(thing())]
    generations.place(renewed, thing(NEW_AT_M + 1), frame)
    for lane in range(CONFIG.swin_size):
        own = rows // lifespans.slice_size == lane
        chosen = np.isin(rows, renewed) & own
        assert 0 < chosen.sum() <= 0.2 * lifespans.slice_size
        assert weights[chosen].max() <= weights[own & ~chosen].min()
    changed = np.zeros(2 * num_gs, bool)
    for array, old in zip(generations.values.arrays, before, strict=True):
        changed |= (array != old).reshape(len(array), -1).any(axis=1)
    assert np.flatnonzero(changed).tolist() == sorted(renewed.tolist())
    assert (renewed < num_gs).all()  # never matured ones
    assert (lifespans.starts[renewed] == frame).all()
    others = np.setdiff1d(np.arange(num_gs), renewed)
    np.testing.assert_array_equal(lifespans.starts[others], starts[others])
    assert (lifespans.expires[renewed] > frame).all()


def flow(motion_m: Floats, guess_m: float = 0.0) -> tuple[Floats, Flags]:
    """(M, 3) flow of a room in which a thing moves, and (M,) whether a Gaussian is of the thing."""
    before = Splats.concatenate([room(), thing()])
    after = Splats.concatenate([room(), thing(NEW_AT_M + motion_m)])
    is_thing = np.arange(len(before)) >= len(room())
    film = Film([before, after])
    rows = np.arange(len(before), dtype=np.int32)
    colour = CameraColour(len(film.cameras), 0)
    values = Parameters(*before.arrays)
    views = [View.prepare(c, NEAR_M) for c in film.cameras]
    compared, _, _ = Comparer(views, film, colour, for_flow=True).compare(values, rows, 1, 0)
    guesses = np.full_like(before.means, guess_m)
    return flow_of(compared, before.means, guesses, np.random.default_rng(0)), is_thing


@pytest.mark.parametrize("motion_m", [(0.3, 0, 0), (0.0, -0.2, 0.1), (0.05, 0.05, -0.05)])
def test_a_thing_is_found_where_it_went_alone(motion_m: tuple[float, float, float]) -> None:
    moved = np.array(motion_m, np.float32)
    motions, is_thing = flow(moved)
    errors_m = np.linalg.norm(motions[is_thing] - moved, axis=1)
    assert np.median(errors_m) < 0.02
    assert np.mean(errors_m < 0.04) > 0.8
    assert np.mean((motions[~is_thing] == 0).all(axis=1)) > 0.97


def test_nothing_moves_where_nothing_changed() -> None:
    for guess_m in (0.0, 0.1):
        assert not flow(np.zeros(3, np.float32), guess_m)[0].any()


@pytest.mark.parametrize("scene_flow", [False, True])
def test_a_window_begins_where_things_went(
    scene_flow: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("trainer.fit.strategy.SETTLE_RENEW_SHARE", 0)
    monkeypatch.setattr("trainer.fit.config.WINDOW_NOISE", 0)
    monkeypatch.setattr("trainer.lease.leases.TRADE_SHARE", 0)
    moved = np.array([0.3, 0, 0], np.float32)
    before = Splats.concatenate([room(), thing()])
    film = Film([before, Splats.concatenate([room(), thing(NEW_AT_M + moved)])])
    config = FitConfig(
        num_gs=len(before), genesis_iterations=0, settle_rounds=1,
        window_iterations=1, scene_flow=scene_flow,
        mcmc=McmcConfig(renew_share=0),
        lease=LeaseConfig(active_share=0.5),
    )  # fmt: skip
    layout = SlotLayout(1, (len(before),), 0, (Lattice.suiting(before),), 15)
    leased = partial(LeasedSlots, layout=layout)
    trainer = Trainer(config, film, before, NEAR_M, strategy=leased)
    for _ in trainer.windows():
        pass
    apart_m = np.linalg.norm(trainer.shown(1).means - NEW_AT_M - moved, axis=1)
    at_new_place = (apart_m < 1.3 * NEW_RADIUS_M).sum()
    assert at_new_place > 32 if scene_flow else at_new_place < 8  # of 40
