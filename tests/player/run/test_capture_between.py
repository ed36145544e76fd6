"""Captures at a higher rate than the stream's: exact frames, motion between them, no jumps."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from codec.lattice.lattice import Lattice, States, quantise
from codec.slots.slotlayout import ENDED, NEW, PREDICTED, SlotLayout, Update
from codec.splats import Splats
from codec.stream import StreamWriter
from player.config import PlayConfig
from player.render.renderer import RendererKind
from player.run.playback import play
from tests.player.render.test_glide import moved, write_body
from tests.support.hosted_streams import random_splats
from tests.support.slots.slot_streams import slot_manifest

NUM_FRAMES = 9


def captured(stream: Path, out: Path, **options: object) -> list[np.ndarray]:
    """The pictures of a capture to PNGs, as (H, W, 3) of -255..255."""
    play(PlayConfig(str(stream), out, renderer=RendererKind.CPU, **options))  # type: ignore[arg-type]
    return [np.array(Image.open(p)).astype(np.int16) for p in sorted(out.glob("*.png"))]


def psnr_db(a: np.ndarray, b: np.ndarray) -> float:
    return float(-10 * np.log10((((a - b) / 255) ** 2).mean() + 1e-12))


def test_what_moves_is_halfway_between_two_frames(tmp_path: Path) -> None:
    write_body(tmp_path / "s")
    plain = captured(tmp_path / "s", tmp_path / "plain")
    double = captured(tmp_path / "s", tmp_path / "double", fps=60.0)
    held = captured(tmp_path / "s", tmp_path / "held", fps=60.0, interpolate=False)
    half = captured(tmp_path / "s", tmp_path / "half", fps=15.0)
    assert [len(found) for found in (plain, double, held, half)] == [9, 18, 18, 5]
    for frame, picture in enumerate(plain):
        assert np.abs(double[2 * frame] - picture).max() <= 1
        assert np.array_equal(held[2 * frame], picture)
        assert np.array_equal(held[2 * frame + 1], picture)
    for n, picture in enumerate(half):
        assert np.array_equal(picture, plain[2 * n])
    for frame in range(1, NUM_FRAMES - 2):  # two frames apart: the frame between them is known
        between = (double[2 * frame - 1] + double[2 * frame + 1]) / 2
        assert psnr_db(between, plain[frame]) > psnr_db(plain[frame - 1], plain[frame]) + 6
    # The last frame stays for its whole duration; a loop begins anew without a way back.
    assert np.array_equal(double[-1], double[-2])
    twice = captured(tmp_path / "s", tmp_path / "twice", fps=60.0, loop=2)
    assert np.array_equal(twice, double * 2)


@pytest.mark.parametrize("status", [NEW, PREDICTED, ENDED])
def test_no_slot_that_is_used_again_shows_on_the_way(tmp_path: Path, status: int) -> None:
    """All slots jump to another place and back, as new Gaussians, as coded differences, or after an
    empty frame. Pictures show Gaussians only in these two places."""
    body = random_splats(50, 0, 3)
    small = np.full((50, 3), -2.5, np.float32)  # so that 2 m are a jump
    body = Splats(body.means, small, *body.arrays[2:])
    there = moved(body, 20)
    lattice = Lattice.suiting(Splats.concatenate([body, there]))
    layout = SlotLayout(1, (len(body),), 0, (lattice,), 4)
    empty = States.zeros(0, 0)
    with StreamWriter.create(tmp_path / "s", slot_manifest(layout)) as writer:
        first: States | None = None
        for birth in range(NUM_FRAMES):
            made, fits = quantise(there if birth % 2 else body, lattice)
            assert fits.all()
            first = first or made
            of_frame = NEW if birth == 0 or (status == ENDED and birth % 2 == 0) else status
            states = empty if of_frame == ENDED else States(made.positions, first.attributes)
            statuses = np.full(len(body), of_frame, np.uint8)
            nothing = np.zeros(len(states), np.uint8)
            writer.append(Update(birth, statuses, states, nothing, nothing > 0, Splats.empty(0)))
    pictures = captured(tmp_path / "s", tmp_path / "out", fps=120.0)
    assert len(pictures) == 4 * NUM_FRAMES
    for n in range(0, len(pictures) - 4, 4):
        here, next_one = pictures[n], pictures[n + 4]
        assert psnr_db(here, next_one) < 30
        bound = np.maximum(here, next_one)
        shares = []
        for between in pictures[n + 1 : n + 4]:
            assert (between <= bound + 40).all()
            assert (between[bound == 0] <= 2).all()  # nothing where neither frame shows anything
            shares.append((psnr_db(between, here), psnr_db(between, next_one)))
        assert [a for a, _ in shares] == sorted((a for a, _ in shares), reverse=True)
        assert [b for _, b in shares] == sorted(b for _, b in shares)
