"""Edits that round: they show the same as edited frames, and streams do not grow."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from codec.arrays import Doubles
from codec.camera import rotation_about
from codec.edit.filters import CropOptions
from codec.edit.rewrite import Options, edit_stream, first_segment_bytes, fitted
from codec.edit.transform import Transform, TransformOptions
from codec.edit.walk import ViewOptions
from codec.errors import SwingsError
from codec.similarity import harmonics
from codec.splats import Splats
from codec.stream import StreamReader
from codec.tools.audit import verify_stream
from player.render.cpu import render_splats
from tests.support.alike import shapes
from tests.support.hostile import refused
from tests.support.slots.edited import (
    edited_frames,
    frames_of,
    least_psnr_db,
    objects_bytes,
    segment_files,
    write_still,
    write_trained_like,
)
from tests.support.slots.slot_streams import write_busy_stream, write_slot_stream
from tests.support.slots.updates import small_layout

OBLIQUE = TransformOptions(1.3, (10, 20, 30), (0.5, -0.25, 1.0), (0, 1, 0))


def write_moving(path: Path) -> Path:
    return write_trained_like(path, 1)


def write_lanes(path: Path) -> Path:
    return write_trained_like(path, 5)


EDITS = (
    *(TransformOptions(scale=0.4), TransformOptions(move=(0.3, -1.2, 2.5))),
    *(TransformOptions(turn=(-90, 0, 0)), OBLIQUE),
)


@pytest.mark.parametrize(
    ("options", "write"),
    [(OBLIQUE, write_still), *itertools.product(EDITS, (write_moving, write_lanes))],
)
def test_the_same_edit_made_on_exported_frames_gives_the_same_pictures(
    options: TransformOptions, write: Callable[[Path], Path], tmp_path: Path
) -> None:
    source = write(tmp_path / "s")
    edit_stream(source, tmp_path / "t", options)
    verify_stream(tmp_path / "t")
    exact = options.similarity()
    assert least_psnr_db(source, tmp_path / "t", lambda splats, _: exact.moved(splats)) >= 45
    # A move takes up to a byte more in a chunk: its first Gaussian is farther from the origin.
    most = 1 if write is write_still else 1.001
    assert objects_bytes(tmp_path / "t") <= objects_bytes(source) * most


NAN, INFINITE = float("nan"), float("inf")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (CropOptions(), "either --box or --sphere"),
        (CropOptions(box=(0, 0, 0, 1, 1, 1), sphere=(0, 0, 0, 1)), "either --box or --sphere"),
        (CropOptions(box=(0, 0, 0, 1, -1, 1)), "must lie below"),
        (CropOptions(box=(0, 0, 0, 1, NAN, 1)), "must lie below"),
        (CropOptions(sphere=(0, 0, 0, 0)), "radius"),
        *((TransformOptions(scale=scale), "scale|finite") for scale in (0, NAN, 1e-9)),
        (TransformOptions(move=(INFINITE, 0, 0)), "scale|finite"),
        *((ViewOptions(view=text), "five or ten") for text in ("", "1,2", "nan,0,1,0,0", "0," * 9)),
        (ViewOptions(camera="nobody"), "no camera is called"),
        (ViewOptions(camera="front", view="0,0,1,0,0"), "cannot be combined"),
        (ViewOptions(), "nothing to change"),
    ],
)
def test_options_that_no_stream_takes(options: Options, message: str, tmp_path: Path) -> None:
    source = write_slot_stream(tmp_path / "s", 3)
    refused(SwingsError, message, edit_stream, source, tmp_path / "t", options)
    assert not (tmp_path / "t").exists()


def test_a_stream_looks_to_its_cameras_as_it_did(tmp_path: Path) -> None:
    source = write_busy_stream(tmp_path / "s", 3, small_layout(1, (60,)), camera_near_m=(0.2,) * 4)
    edit_stream(source, tmp_path / "t", TransformOptions(2.0, (0, 90, 0), (1, 2, 3), (4, 5, 6)))
    before, after = StreamReader(source), StreamReader(tmp_path / "t")
    assert after.manifest.near_m == 2 * before.manifest.near_m
    assert after.manifest.camera_near_m == (0.4,) * 4
    for camera in before.manifest.cameras:
        seen, again = (
            render_splats(
                reader.active_splats(1, 1),
                reader.manifest.camera(camera.name),
                reader.manifest.near_m,
            )
            for reader in (before, after)
        )
        assert seen.max() > 0.05
        np.testing.assert_allclose(again, seen, atol=2e-3)


def test_scaling_alone_copies_all_objects(tmp_path: Path) -> None:
    source = write_trained_like(tmp_path / "s", 5)
    made = edit_stream(source, tmp_path / "t", TransformOptions(scale=3.0))
    assert made.num_copied == made.num_segments
    assert segment_files(tmp_path / "t") == segment_files(source)
    first, again = next(frames_of(source)), next(frames_of(tmp_path / "t"))
    np.testing.assert_allclose(again.means, 3 * first.means, rtol=1e-6)
    np.testing.assert_allclose(again.log_scales, first.log_scales + np.log(3), atol=1e-5)


@pytest.mark.parametrize("axis", range(3))
def test_four_quarter_turns_bring_everything_back(axis: int, tmp_path: Path) -> None:
    source = write_slot_stream(tmp_path / "0", 9, small_layout(2, (20, 10), 1))
    for n in range(4):
        x, y, z = (90.0 * (axis == one) for one in range(3))
        quarter = TransformOptions(turn=(x, y, z))
        edit_stream(tmp_path / str(n), tmp_path / str(n + 1), quarter)
    verify_stream(tmp_path / "4")
    for before, after in zip(frames_of(source), frames_of(tmp_path / "4"), strict=True):
        # -128 has no opposite on the lattice: such a Gaussian has escaped, and its floats turn.
        a, b = (splats.take(np.lexsort(splats.means.T)) for splats in (before, after))
        np.testing.assert_allclose(b.means, a.means, atol=1e-4)
        np.testing.assert_allclose(b.sh, a.sh, atol=1e-4)
        np.testing.assert_array_equal(b.logit_opacities, a.logit_opacities)
        both = [shapes(splats) for splats in (a, b)]
        np.testing.assert_allclose(both[1], both[0], rtol=1e-3, atol=1e-4 * both[0].max())
    # About x, then y, then z.
    turn = TransformOptions(turn=(90, 90, 90)).similarity().turn
    about = (rotation_about(one, np.pi / 2) for one in np.eye(3)[::-1])
    np.testing.assert_allclose(turn, np.linalg.multi_dot([*about]), atol=1e-12)


def seen_along(splats: Splats, directions: Doubles) -> Doubles:
    """(N, J, 3) colours of `splats` along (J, 3) directions, less 0.5."""
    basis = harmonics(directions)[:, : splats.sh.shape[1]]
    seen: Doubles = np.einsum("jk,nkc->njc", basis, splats.sh.astype(np.float64))
    return seen


@pytest.mark.parametrize("degree", [1, 3])
def test_colours_turn_with_the_scene_at_any_angle(degree: int, tmp_path: Path) -> None:
    layout = small_layout(1, (30, 20), degree)
    source = write_slot_stream(tmp_path / "s", 3, layout)
    exact = OBLIQUE.similarity()
    directions = np.random.default_rng(2).normal(size=(20, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    for before, after in edited_frames(source, tmp_path / "t", OBLIQUE):
        moved = exact.moved(before)
        near = np.abs(moved.means[:, None] - after.means[None]).max(axis=2).argmin(axis=1)
        found = after.take(near)
        assert np.abs(found.means - moved.means).max() < 0.03  # of steps of 0.013 and 0.026 m
        error = seen_along(found, directions @ exact.turn.T) - seen_along(before, directions)
        spread = seen_along(before, directions).std()
        assert error.std() < 0.02 * spread


def test_what_moves_off_the_lattice_is_sent_as_floats(tmp_path: Path) -> None:
    source = write_slot_stream(tmp_path / "s", 6, small_layout(2, (10, 5)))
    far = TransformOptions(move=(83880, 0, 0))  # 2^23 steps of 0.01 m end 6 m behind that
    for before, after in edited_frames(source, tmp_path / "t", far):
        found, wanted = after.means[:, 0], far.similarity().moved(before).means[:, 0]
        assert len(found)
        np.testing.assert_allclose(np.sort(found), np.sort(wanted), atol=0.03)


TURN = TransformOptions(turn=(10, 20, 30))


def test_steps_grow_until_the_first_segment_does_not(tmp_path: Path) -> None:
    reader = StreamReader(write_trained_like(tmp_path / "s", 5))
    limit_bytes = sum(reader.records[0].part_bytes)
    # With steps half as large the turned stream is larger, so there is something to fit.
    edit = Transform(TURN, reader.manifest, 0.5)
    assert first_segment_bytes(reader, edit) > limit_bytes
    made = fitted(reader, edit)
    assert made is not edit
    assert first_segment_bytes(reader, made) <= limit_bytes
