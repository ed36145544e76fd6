"""Contributions: they are the blending weights, they add up to the light, and they order slices."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numba
import numpy as np
import numpy.typing as npt
import pytest
import torch

from codec.camera import Camera
from codec.errors import InvalidError
from codec.profiles.profile import Profile
from codec.slice import Slice, active_splats
from codec.splats import SH_C0, Splats
from codec.stream import StreamReader, StreamWriter
from codec.stream.layers import Rank
from codec.stream.manifest import Manifest
from player.render.cpu import render_splats
from player.render.recipe import ALPHA_MAX, ALPHA_MIN, TRANSMITTANCE_MIN
from tests.support.reference_render import render_reference
from trainer.fit.config import FitConfig
from trainer.fit.trainer import Trainer
from trainer.pictures.shot import Shot
from trainer.run.rank import matured_by_contribution, slices_by_contribution
from trainer.seed.gaussians import initial_splats
from trainer.step.contribution import contribution
from trainer.step.raster import Parameters, Rendered, View, render

NEAR_M = 0.2
WHITE = 0.5 / SH_C0
Doubles = npt.NDArray[np.float64]


def scene(count: int, seed: int, logit: float = 0.5) -> Splats:
    rng = np.random.default_rng(seed)
    return Splats(
        rng.uniform(-1.2, 1.2, (count, 3)).astype(np.float32),
        np.log(rng.uniform(0.02, 0.3, (count, 3))).astype(np.float32),
        rng.normal(size=(count, 4)).astype(np.float32),
        rng.normal(logit, 1.5, count).astype(np.float32),
        (rng.normal(size=(count, 1, 3)) * 0.6).astype(np.float32),
    )


def camera(angle: float = 0.4, name: str = "test") -> Camera:
    # Off-centre and not a whole number of tiles: what lies beside the picture must not count.
    w2c = np.eye(4)
    w2c[:3, :3] = [
        [np.cos(angle), 0, np.sin(angle)],
        [0, 1, 0],
        [-np.sin(angle), 0, np.cos(angle)],
    ]
    w2c[:3, 3] = (0.1, -0.2, 2.2)
    return Camera(name, 45, 37, 40.0, 43.0, 21.0, 20.0, w2c)


def rendered(splats: Splats, cam: Camera) -> Rendered:
    return render(
        Parameters(*splats.arrays),
        np.arange(len(splats), dtype=np.int32),
        View.prepare(cam, NEAR_M),
    )


def plain_blend(drawn: Rendered) -> tuple[Doubles, Doubles]:
    """In float64, over whole pictures: weights summed by Gaussian, (H, W) transmittance left."""
    cam = drawn.view.camera
    v, u = np.mgrid[0 : cam.height_px, 0 : cam.width_px] + 0.5
    seen = np.ones((cam.height_px, cam.width_px))
    is_open = np.ones(seen.shape, np.bool_)
    sums = np.zeros(len(drawn.rows))
    depths = drawn.projection.depths
    for i in np.argsort(depths):
        if not np.isfinite(depths[i]):
            continue
        x, y, a, b, c, opacity = drawn.projection.projected[i, :6].astype(np.float64)
        dx, dy = u - x, v - y
        alpha = np.minimum(
            ALPHA_MAX, opacity * np.exp(-(a * dx * dx + c * dy * dy) / 2 - b * dx * dy)
        )
        shows = is_open & (alpha >= ALPHA_MIN)
        ends = shows & (seen * (1 - alpha) < TRANSMITTANCE_MIN)
        is_open &= ~ends
        weight = np.where(shows & ~ends, seen * alpha, 0)
        sums[i] = weight.sum()
        seen -= weight
    return sums, seen


@pytest.mark.parametrize(("count", "logit"), [(60, -1.0), (400, 4.0)])
def test_it_is_the_weight_of_a_plain_blend(count: int, logit: float) -> None:
    drawn = rendered(scene(count, 2, logit), camera())
    expected, left = plain_blend(drawn)
    got = contribution(drawn)
    # The dense scene lets so little light through that the threshold ends pixels.
    assert (left < 100 * TRANSMITTANCE_MIN).any() == (logit > 0)
    # A pixel near 1/255 or the threshold may fall to the other side in float32.
    assert np.abs(got - expected).max() < 0.02
    assert np.quantile(np.abs(got - expected), 0.9) < 1e-3
    assert expected.max() > 20


@pytest.mark.parametrize(("count", "logit"), [(60, -1.0), (400, 4.0)])
def test_contributions_and_the_light_left_are_the_pixels(count: int, logit: float) -> None:
    cam = camera()
    drawn = rendered(scene(count, 2, logit), cam)
    _, left = plain_blend(drawn)
    pixels = cam.width_px * cam.height_px
    assert float(contribution(drawn).sum()) + left.sum() == pytest.approx(pixels, abs=0.1)


def test_ignored_pixels_add_nothing() -> None:
    cam = camera()
    drawn = rendered(scene(60, 2, -1.0), cam)
    rng = np.random.default_rng(1)
    parts = rng.integers(0, 2, (cam.height_px, cam.width_px), dtype=np.uint8)
    one, other = contribution(drawn, parts), contribution(drawn, 1 - parts)
    np.testing.assert_allclose(one + other, contribution(drawn), atol=1e-3)
    assert one.sum() == pytest.approx(contribution(drawn).sum() / 2, rel=0.1)
    assert not contribution(drawn, np.zeros_like(parts)).any()


def test_they_add_up_to_the_picture_of_a_white_scene() -> None:
    splats, cam = scene(200, 4), camera()
    splats.sh[:] = WHITE
    picture = render_splats(splats, cam, NEAR_M)
    assert float(contribution(rendered(splats, cam)).sum()) == pytest.approx(
        float(picture[..., 0].sum(dtype=np.float64)), rel=1e-5
    )


def test_it_is_the_slope_of_the_references_picture_by_colour() -> None:
    splats, cam = scene(80, 6), camera()
    splats.sh[:] = 0.1  # far from black, where the colour would be cut
    means, scales, quats, logits, sh = (
        torch.tensor(array, dtype=torch.float64) for array in splats.arrays
    )
    sh.requires_grad_()
    red = render_reference(means, scales, quats, logits, sh, cam, NEAR_M)[..., 0]
    torch.autograd.backward(red.sum())
    assert sh.grad is not None
    expected = sh.grad[:, 0, 0].numpy() / SH_C0
    got = contribution(rendered(splats, cam))
    assert np.abs(got - expected).max() < 0.02
    assert expected.max() > 20


def test_what_is_hidden_or_behind_contributes_nothing() -> None:
    splats, cam = scene(3, 0), camera(0.0)
    splats.means[:] = [(0, 0, 0), (0, 0, 0.5), (0, 0, -5)]
    splats.log_scales[:] = np.log([[2.0] * 3, [0.05] * 3, [0.05] * 3])
    splats.logit_opacities[:] = (9, 9, 9)
    second_wall = Splats.concatenate([splats.take(np.array([0])), splats])
    wall, _, hidden, behind = contribution(rendered(second_wall, cam)).tolist()
    assert wall > 1000
    # Two walls of alpha 0.99 leave 1e-4 of the light.
    assert hidden < 0.01
    assert behind == 0
    assert contribution(rendered(Splats.empty(), cam)).shape == (0,)


def test_any_number_of_threads_gives_the_same_bits() -> None:
    drawn = rendered(scene(300, 8), camera())
    many = numba.get_num_threads()
    expected = contribution(drawn).tobytes()
    numba.set_num_threads(1)
    try:
        assert contribution(drawn).tobytes() == expected
    finally:
        numba.set_num_threads(many)


def by_hand(splats: Splats, cameras: list[Camera]) -> Doubles:
    """What each Gaussian adds: the picture with it alone white, all others black."""
    sums = np.zeros(len(splats))
    for i in range(len(splats)):
        sh = np.full_like(splats.sh, -WHITE)
        sh[i] = WHITE
        alone = replace(splats, sh=sh)
        for cam in cameras:
            sums[i] += float(render_splats(alone, cam, NEAR_M)[..., 1].sum(dtype=np.float64))
    return sums


def rows_of(part: Slice) -> list[bytes]:
    s = part.splats
    columns = (s.means, s.log_scales, s.quats, s.logit_opacities[:, None], s.sh[:, 0])
    table = np.concatenate([*columns, part.start_offsets[:, None]], axis=1)
    return [row.tobytes() for row in table.astype(np.float64)]


def assert_falls(values: Doubles) -> None:
    assert (np.diff(values) <= 1e-3).all(), values
    assert values[0] > values[-1] + 1


SWIN, FRAMES, SLICE_SIZE = 3, 4, 8
CAMERAS = [camera(0.4, "a"), camera(-0.3, "b")]


@pytest.fixture
def stream(tmp_path: Path) -> StreamReader:
    """A raw stream; in every slice some Gaussians start late."""
    manifest = Manifest(
        fps=30.0,
        swin_size=SWIN,
        num_gs=SWIN * SLICE_SIZE,
        layers=(0.5, 0.5),
        segment_frames=2,
        sh_degree=0,
        profile=Profile.RAW,
        antialias=False,
        near_m=NEAR_M,
        bounds=((-1.0, -1.0, -1.0), (1.0, 1.0, 1.0)),
        cameras=tuple(CAMERAS),
        default_camera="a",
        live=False,
    )
    with StreamWriter.create(tmp_path / "stream", manifest) as writer:
        for birth in range(1 - SWIN, FRAMES):
            offsets = np.arange(SLICE_SIZE, dtype=np.uint8) % SWIN
            writer.append(Slice(birth, scene(SLICE_SIZE, birth + 50), offsets))
    return StreamReader(tmp_path / "stream")


def test_the_slices_of_a_stream_fall_by_what_they_show(stream: StreamReader) -> None:
    views = [View.prepare(cam, NEAR_M) for cam in CAMERAS]
    found = list(slices_by_contribution(stream, views))
    stored = list(stream.slices(1 - SWIN, 2))
    assert [part.birth for part in found] == [part.birth for part in stored]
    sums = {part.birth: np.zeros(SLICE_SIZE) for part in found}
    for frame in range(FRAMES):
        window = found[frame : frame + SWIN]
        added = by_hand(active_splats(window, frame, SWIN), CAMERAS)
        for part in window:
            shown = part.active(frame, SWIN)
            sums[part.birth][shown] += added[: shown.sum()]
            added = added[shown.sum() :]
    for part, before in zip(found, stored, strict=True):
        assert sorted(rows_of(part)) == sorted(rows_of(before))
        assert_falls(sums[part.birth])
    assert [rows_of(part) for part in found] != [rows_of(part) for part in stored]


def test_a_stream_written_as_given_keeps_the_order_in_its_layers(
    stream: StreamReader, tmp_path: Path
) -> None:
    slices = list(slices_by_contribution(stream, [View.prepare(CAMERAS[0], NEAR_M)]))
    with StreamWriter.create(tmp_path / "again", stream.manifest, Rank.GIVEN) as writer:
        for part in slices:
            writer.append(part)
    again = StreamReader(tmp_path / "again")
    for part in slices:
        half = rows_of(part)[: SLICE_SIZE // 2]
        assert rows_of(again.slice(part.birth, 1)) == half
        assert rows_of(again.slice(part.birth, 2)) == rows_of(part)


def test_a_stream_without_a_frame_is_refused(stream: StreamReader, tmp_path: Path) -> None:
    StreamWriter.create(tmp_path / "empty", stream.manifest).abort()
    with pytest.raises(InvalidError, match="no finished segment"):
        list(slices_by_contribution(StreamReader(tmp_path / "empty"), []))


class Grey:
    """Pictures of nothing in particular."""

    num_frames = FRAMES
    cameras = CAMERAS

    def shot(self, camera: int, frame: int) -> Shot:
        return Shot(np.full((37, 45, 3), 60 + 30 * frame + 9 * camera, np.uint8))

    def mask(self, camera: int, frame: int) -> None:
        return None


@pytest.mark.parametrize("swin_size", [1, 2])
def test_a_trainers_slices_fall_by_what_they_show(swin_size: int) -> None:
    rng = np.random.default_rng(1)
    points = rng.uniform(-0.7, 0.7, (24, 3)).astype(np.float32)
    initial = initial_splats(points, rng.integers(0, 255, (24, 3), dtype=np.uint8), 0)
    config = FitConfig(num_gs=24, swin_size=swin_size, genesis_iterations=40, window_iterations=10)
    trainer = Trainer(config, Grey(), initial, NEAR_M)
    found: list[Slice] = []
    for window in trainer.windows():
        ordered = matured_by_contribution(trainer, window)
        for part, before in zip(ordered, window.slices, strict=True):
            assert part.birth == before.birth
            assert sorted(rows_of(part)) == sorted(rows_of(before))
        found += ordered
        if swin_size == 1:  # nothing but the slice itself shows
            assert_falls(by_hand(ordered[0].splats, CAMERAS))
    # The last slice shows in the last frame only, where all that shows has matured.
    last = found[-swin_size:]
    shown = last[-1].active(FRAMES - 1, swin_size)
    added = by_hand(active_splats(last, FRAMES - 1, swin_size), CAMERAS)[-shown.sum() :]
    assert shown.all()
    assert_falls(added)
