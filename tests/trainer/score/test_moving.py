"""Moving pixels, and the score of a stream on them; and pictures in a camera's colours."""

from __future__ import annotations

from dataclasses import replace
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from PIL import Image
from rich.console import Console

from codec.arrays import Flags, Floats
from codec.stream import StreamWriter
from tests.support.tiny_capture import HEIGHT_PX, WIDTH_PX, seen_by, write_dynamic3dgs
from tests.support.tiny_stream import tiny_manifest, tiny_slice
from trainer.capture.capture import Mask, Picture
from trainer.pictures.scale import Shot
from trainer.score.evaluate import EvaluateConfig, Evaluation, evaluate_stream
from trainer.score.scores import colour_fitted
from trainer.score.sheet import ENLARGED, HEADER_PX, write_sheet
from trainer.score.truth import MIN_MOVING_PX, Movement, captured, movement_of
from trainer.step.loss import psnr_db

FRAMES = 4
GREY = 40
BLOCK = (slice(10, 20), slice(10, 30))
"""A block of 200 pixels. A jump by 60 moves them and the 60 adjacent ones, whose means change by
20; the means at its corners change by 6.7."""
BLOCK_PX, BESIDE_PX = 200, 60
BRIGHTNESS = (40, 100, 160, 165)
"""Brightness of the block, frame by frame; from frame 2 to 3 it does not move."""


def grey(value: int, size: tuple[int, int] = (30, 40)) -> Picture:
    return np.full((*size, 3), value, np.uint8)


def changed(by: int, where: tuple[slice, slice], channel: slice = slice(None)) -> Picture:
    picture = grey(GREY)
    picture[(*where, channel)] += np.uint8(by)
    return picture


def moving(before: Picture, now: Picture, mask: Mask | None = None) -> Flags:
    return movement_of(Shot(before), Shot(now, mask)).pixels


def test_a_pixel_moves_if_the_mean_of_one_channel_changes_enough() -> None:
    for start in (0, 1, 100, 242):
        for change, moves in ((12, False), (13, True)):
            for a, b in ((start, start + change), (start + change, start)):
                assert (moving(grey(a), grey(b)) == moves).all()
    for channel in range(3):
        now = changed(13, np.s_[:, :], slice(channel, channel + 1))
        assert moving(grey(GREY), now).all()
    now = grey(GREY)
    now[::2, ::2] += 20
    now[1::2, 1::2] -= 20
    assert not moving(grey(GREY), now).any()


def test_the_mean_of_3x3_decides() -> None:
    expected = np.zeros((30, 40), bool)
    assert np.array_equal(moving(grey(GREY), changed(108, np.s_[5:6, 7:8])), expected)
    expected[4:7, 6:9] = True
    assert np.array_equal(moving(grey(GREY), changed(109, np.s_[5:6, 7:8])), expected)
    # In the corner the nearest pixel replaces those outside: 4 of 9 are the changed one.
    expected[:] = False
    expected[0, 0] = True
    assert np.array_equal(moving(grey(GREY), changed(28, np.s_[0:1, 0:1])), expected)
    assert not moving(grey(GREY), changed(27, np.s_[0:1, 0:1])).any()


def test_what_a_mask_ignores_neither_moves_nor_moves_its_neighbours() -> None:
    now = grey(GREY + 13)
    mask = np.ones((30, 40), np.uint8)
    mask[8:20, 8:20] = 0
    now[8:20, 8:20] = 0
    for masks in ((None, mask), (mask, None), (mask, mask)):
        found = movement_of(Shot(grey(GREY), masks[0]), Shot(now, masks[1]))
        assert np.array_equal(found.pixels, mask > 0)
        assert found.counting == found.moving == 30 * 40 - 144
    # Conversely: ignored pixels jump, the others do not change.
    still = grey(GREY)
    still[8:20, 8:20] = 255
    assert moving(grey(GREY), still).any()
    assert not moving(grey(GREY), still, mask).any()
    assert not moving(grey(GREY), still, np.zeros_like(mask)).any()


def test_psnr_is_that_of_the_moving_pixels_alone_if_there_are_enough() -> None:
    now = changed(60, BLOCK)
    found = movement_of(Shot(grey(GREY)), Shot(now))
    assert found.moving == BLOCK_PX + BESIDE_PX
    truth = captured(now)
    shown = truth.copy()
    shown[~found.pixels] = 1  # has no effect
    shown[found.pixels] += np.float32(0.1)
    assert found.psnr_db(shown, truth) == pytest.approx(20, abs=1e-4)
    for missing in (0, 1):
        mask = np.zeros((30, 40), np.uint8)
        mask.ravel()[: MIN_MOVING_PX - missing] = 1
        found = movement_of(Shot(grey(0)), Shot(grey(99), mask))
        assert found.moving == MIN_MOVING_PX - missing
        score = found.psnr_db(np.zeros_like(truth), np.ones_like(truth))
        assert score is None if missing else score == pytest.approx(0)


def expected_db(brightness: int) -> float:
    """PSNR of black pixels against the block and the adjacent pixels."""
    squares = BLOCK_PX * brightness**2 + BESIDE_PX * GREY**2
    return -10 * float(np.log10(squares / (BLOCK_PX + BESIDE_PX) / 255**2))


MEAN_DB = (expected_db(100) + expected_db(160)) / 2


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a capture, whose held-out camera sees a grey block on a grey wall, see
    BRIGHTNESS, and with a stream of invisible Gaussians."""
    root = tmp_path_factory.mktemp("moving")
    write_dynamic3dgs(root / "capture", num_cameras=3, num_frames=FRAMES)
    for frame, brightness in enumerate(BRIGHTNESS):
        picture = grey(GREY, (HEIGHT_PX, WIDTH_PX))
        picture[BLOCK] = brightness
        Image.fromarray(picture).save(root / f"capture/ims/1/{frame:06d}.png")
    manifest = seen_by(tiny_manifest(), root / "capture")
    with StreamWriter.create(root / "stream", manifest) as writer:
        for birth in range(manifest.first_birth, FRAMES):
            part = tiny_slice(birth)
            part.splats.logit_opacities[:] = -20
            writer.append(part)
    return root


def evaluate(folder: Path, every: int = 1) -> Evaluation:
    return evaluate_stream(EvaluateConfig(folder / "stream", folder / "capture", every=every))


def test_a_stream_is_scored_on_what_moves(folder: Path) -> None:
    found = evaluate(folder)
    assert found.moving_share == pytest.approx(2 * 260 / (3 * HEIGHT_PX * WIDTH_PX))
    for score in found.layers:
        nothing, *moved, still = score.per_frame_moving_psnr_db
        assert nothing is None
        assert still is None
        assert moved == pytest.approx([expected_db(100), expected_db(160)], abs=1e-3)
        assert score.moving_psnr_db == pytest.approx(MEAN_DB, abs=1e-3)


def test_the_sheet_shows_what_moves_twice_as_large(folder: Path, tmp_path: Path) -> None:
    """There is a separate line below frames 1 and 2; in frames 0 and 3 nothing has moved since the
    previous frame."""
    write_sheet(folder / "stream", folder / "capture", tmp_path / "sheet.png")
    with Image.open(tmp_path / "sheet.png") as image:
        sheet = np.asarray(image)
    lines = sheet.reshape(6, HEADER_PX + HEIGHT_PX, 3 * WIDTH_PX, 3)[:, HEADER_PX:]
    for line, brightness in ((lines[2], 100), (lines[4], 160)):
        assert (line[:, :WIDTH_PX] == brightness).any(axis=2).sum() == BLOCK_PX * ENLARGED**2
        assert (line[:, WIDTH_PX : 2 * WIDTH_PX] == 0).all()


@settings(max_examples=25)
@given(arrays(np.bool_, (14, 23)), st.integers(1, 14), st.integers(1, 23))
def test_the_box_moves_most(pixels: Flags, height_px: int, width_px: int) -> None:
    box = Movement(pixels, pixels.size).busiest(height_px, width_px)
    if box is None:
        assert pixels.sum() < MIN_MOVING_PX
        return
    assert pixels[box].shape == (height_px, width_px)
    windows = np.lib.stride_tricks.sliding_window_view(pixels, (height_px, width_px))
    assert pixels[box].sum() == windows.sum(axis=(2, 3)).max()


def test_every_nth_frame_is_still_compared_with_the_one_before(folder: Path) -> None:
    found = evaluate(folder, every=2)
    first, second = found.layers[-1].per_frame_moving_psnr_db
    assert first is None
    assert second == pytest.approx(expected_db(160), abs=1e-3)
    assert found.moving_share == pytest.approx(260 / (HEIGHT_PX * WIDTH_PX))
    alone = evaluate(folder, every=FRAMES)
    assert alone.moving_share is None
    assert alone.layers[-1].per_frame_moving_psnr_db == [None]


def test_the_table_shows_what_moves_and_each_camera_whatever_its_name(folder: Path) -> None:
    found = evaluate(folder)
    name, console = "[b]" + "kitchen" * 12, Console(width=80, file=StringIO())
    one = {"per_camera_psnr_db": {name: 20.0}, "per_camera_fitted_psnr_db": {name: 20.0}}
    layers = [replace(s, **one, bits_per_second=29.6e6) for s in found.layers]  # type: ignore[arg-type]
    with console.capture() as shown:
        of_camera = replace(found, stream="stream", layers=layers, unseen_shares={name: 0.123})
        console.print(of_camera.table())
    lines = shown.get().splitlines()
    assert max(map(len, lines)) <= 80
    assert "7.5% of pixels move" in lines[0]
    cells = [[cell.strip() for cell in line.split("│")[1:-1]] for line in lines if "│" in line]
    rows = {first: others for first, *others in cells}
    assert rows["2"][1] == f"{MEAN_DB:.2f}"
    assert "".join(rows) == f"12{name}mean"
    assert "12%" in " ".join(cell for others in rows.values() for cell in others)


COLOURS = st.tuples(st.floats(0.5, 1.5), st.floats(-0.2, 0.2))


def noise(seed: int) -> Floats:
    return np.random.default_rng(seed).random((6, 7, 3), np.float32)


@settings(max_examples=25)
@given(st.integers(0, 99), st.tuples(COLOURS, COLOURS, COLOURS))
def test_a_camera_s_colours_cost_nothing(seed: int, cast: tuple[tuple[float, float], ...]) -> None:
    shown = noise(seed)
    gain_bias = np.array(cast, np.float32)
    truth: Floats = gain_bias[:, 0] * shown + gain_bias[:, 1]
    assert colour_fitted(shown, truth) == pytest.approx(truth, abs=1e-5)


@settings(max_examples=25)
@given(st.integers(0, 99))
def test_no_other_colours_fit_better(seed: int) -> None:
    shown, truth = noise(seed), noise(seed + 100)
    best = psnr_db(colour_fitted(shown, truth), truth)
    assert best >= psnr_db(shown, truth)
    rng = np.random.default_rng(seed)
    for _ in range(5):
        gain, bias = rng.normal(1, 0.3, 3), rng.normal(0, 0.1, 3)
        assert best >= psnr_db((gain * shown + bias).astype(np.float32), truth) - 1e-6


def test_what_a_mask_ignores_does_not_count() -> None:
    shown = noise(0)
    truth: Floats = np.float32(0.5) * shown + np.float32(0.1)
    mask = np.ones((6, 7), np.uint8)
    mask[:, 4:] = 0
    other = truth.copy()
    other[:, 4:] = 1
    assert (colour_fitted(shown, other, mask) == colour_fitted(shown, truth, mask)).all()
    assert colour_fitted(shown, other, np.zeros((6, 7), np.uint8)) is shown
    # A channel of one value is only moved.
    flat = np.full_like(truth, 0.25)
    expected = np.broadcast_to(truth.mean(axis=(0, 1)), truth.shape)
    assert colour_fitted(flat, truth) == pytest.approx(expected, abs=1e-6)
