"""Benches that score a stream against its capture, on one small stream: their figures are those of
swings-eval, and their tables and plots show them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from statistics import fmean
from typing import Any

import numpy as np
import pytest
from rich.console import Console, RenderableType

from bench import flip
from bench.flip import FlipConfig
from bench.ghost import excess, left_and_around
from bench.network import shown
from bench.play import between
from bench.play.between import FADED, HELD, INTERPOLATED, SENT, BetweenConfig
from codec.errors import InvalidError
from codec.stream import StreamReader
from tests.player.render.test_glide import write_body
from tests.support.hostile import refused
from tests.support.slots.slot_streams import write_busy_stream
from tests.support.slots.updates import small_layout
from tests.support.tiny_capture import write_dynamic3dgs
from trainer.capture.layout import open_capture
from trainer.score.evaluate import EvaluateConfig, evaluate_stream
from trainer.score.truth import open_held_out

FRAMES = 6
PLANES: dict[str, dict[str, Any]] = {
    "every": {"near_m": 6.9}, "own": {"camera_near_m": (6.9,) * 4}, "none": {},
}  # fmt: skip
"""Changes of a manifest: one near plane for every view, the same plane as each camera's own, and
none."""


def write_scored(path: Path, **changes: object) -> tuple[Path, Path]:
    """Writes a stream of FRAMES frames and two layers, and its capture, whose camera 1 is held out;
    returns the folders of both. changes: fields of the manifest."""
    capture, stream = path / "capture", path / "stream"
    path.mkdir(exist_ok=True)
    write_dynamic3dgs(capture, num_cameras=4, num_frames=FRAMES)
    cameras = tuple(c.camera for c in open_capture(capture).cameras)
    layout = small_layout(2, (60, 40), 0, 4)
    changes = {"cameras": cameras, "default_camera": cameras[0].name, **changes}
    write_busy_stream(stream, FRAMES, layout, **changes)
    return stream, capture


@pytest.fixture(scope="module")
def scored(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    return write_scored(tmp_path_factory.mktemp("scored"))


def text_of(table: RenderableType, width: int = 160) -> str:
    console = Console(width=width)
    with console.capture() as shown_text:
        console.print(table)
    return shown_text.get()


MEASURES: dict[str, Callable[[Path, Path], object]] = {
    "flip": lambda stream, capture: flip.scored(FlipConfig(stream, capture, every=3)),
    "between against the stream": lambda stream, capture: between.against_stream(
        StreamReader(stream), 2, BetweenConfig(stream, capture, pictures=2)
    ),
    "between against the film": lambda stream, capture: between.against_film(
        BetweenConfig(stream, capture, pictures=2)
    ),
}


@pytest.mark.parametrize("what", MEASURES)
def test_a_camera_has_its_own_near_plane(what: str, tmp_path: Path) -> None:
    every, own, none = (
        MEASURES[what](*write_scored(tmp_path / name, **changes))
        for name, changes in PLANES.items()
    )
    assert own == every
    assert own != none


# --- flip ---


def test_flip_stands_beside_the_scores_of_swings_eval(scored: tuple[Path, Path]) -> None:
    found = flip.scored(FlipConfig(*scored))
    psnr_db, each, moving_db, moving_flip = found["cam01"]
    expected = evaluate_stream(EvaluateConfig(*scored)).layers[-1]
    assert np.mean(psnr_db) == pytest.approx(expected.psnr_db, abs=1e-3)
    assert len(each) == FRAMES
    assert all(0 < value < 1 for value in each)
    assert len(moving_db) == len(moving_flip)
    if expected.moving_psnr_db is not None:
        assert np.mean(moving_db) == pytest.approx(expected.moving_psnr_db, abs=1e-3)
    assert f"{np.mean(each):.4f}" in text_of(flip.table(found))


# --- between ---


def test_what_moves_straight_is_interpolated_best(tmp_path: Path) -> None:
    write_body(tmp_path / "s")
    reader = StreamReader(tmp_path / "s")
    config = BetweenConfig(tmp_path / "s", pictures=3)
    near, far = (between.against_stream(reader, gap, config) for gap in (2, 4))
    for scores in (near, far):
        assert min(scores.goes_on) > 0.9  # small Gaussians jump
        assert len(scores.whole[HELD]) == 3 * len(reader.manifest.cameras[:2])
        by = {how: np.mean(found) for how, found in scores.changing.items()}
        assert by[INTERPOLATED] > by[FADED] + 6 > by[HELD] + 6
    assert np.mean(far.whole[HELD]) < np.mean(near.whole[HELD])
    for gap in (1, 3, 100):  # without a middle, or too long
        refused(InvalidError, r"gap \d+", between.against_stream, reader, gap, config)


def test_pictures_between_are_scored_against_the_film(scored: tuple[Path, Path]) -> None:
    film = between.against_film(BetweenConfig(*scored, gaps=(2,)))
    assert set(film.whole) == {HELD, FADED, INTERPOLATED, SENT}
    assert len(film.goes_on) == 2


# --- shown ---


def report_of(reader: StreamReader, layers: int, late_s: float = 0.0) -> dict[str, Any]:
    """The report of a play in which `layers` layers arrived before the start, and the others
    `late_s` after the frame in which they were due; never if `late_s` is 0."""
    manifest = reader.manifest
    arrivals = []

    def came(first_layer: int, count: int, came_s: float, **what: int) -> None:
        packets = {"first_layer": first_layer, "layers": count, "bytes": 1, "came_s": came_s}
        arrivals.append({"play": 0, "birth": None, "keyframe_frame": None, **packets, **what})

    for first, count in ((0, layers), (layers, manifest.num_layers - layers)):
        if not count or (first and not late_s):
            continue
        came(first, count, late_s if first else 0.0, keyframe_frame=0)
        for birth in range(1, FRAMES):
            came(first, count, birth + late_s if first else 0.0, birth=birth)
    frames = [{"play": 0, "frame": frame, "shown_s": float(frame)} for frame in range(FRAMES)]
    return {"frames": frames, "arrivals": arrivals, "dropped": {"frames": 0, "arrivals": 0}}


def test_shown_frames_score_what_had_come(scored: tuple[Path, Path]) -> None:
    expected = evaluate_stream(EvaluateConfig(*scored)).layers
    with open_held_out(*scored) as held_out:
        for layers in (1, 2):
            scores = list(shown.shown_scores(held_out, report_of(held_out.reader, layers), 1))
            assert [score.frame for score in scores] == list(range(FRAMES))
            found = [score.rendered_db for score in scores]
            assert found == pytest.approx(expected[layers - 1].per_frame_psnr_db, abs=1e-6)
            assert scores[-1].layers == layers
        # Packets that arrive half a frame late show from the next frame on.
        late = list(shown.shown_scores(held_out, report_of(held_out.reader, 1, 0.5), 1))
        assert late[0].rendered_db == pytest.approx(expected[0].per_frame_psnr_db[0], abs=1e-6)
        assert 1 < fmean(score.layers for score in late) < 2
        report = report_of(held_out.reader, 2)
        assert [score.frame for score in shown.shown_scores(held_out, report, 2)] == [0, 2, 4]
        report["dropped"]["arrivals"] = 1
        with pytest.raises(InvalidError, match="lacks part of the play"):
            list(shown.shown_scores(held_out, report, 1))
    assert "all" in text_of(shown.table_of(late))


# --- ghost ---

RED = np.array([0.8, 0.4, 0.2], np.float32)
GREY = np.array([0.4, 0.4, 0.4], np.float32)
EVERYWHERE = np.ones((40, 60), np.bool_)


def with_ball(column: int) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
    """(40, 60, 3) a red square of 10 pixels on grey."""
    picture = np.tile(GREY, (40, 60, 1))
    picture[15:25, column : column + 10] = RED
    return picture


def test_a_ghost_is_found_where_the_ball_was() -> None:
    before, now = with_ball(10), with_ball(18)
    left, ring = left_and_around(before, now, (before != now).any(axis=2), None)
    rows, columns = np.nonzero(left)
    # The edge of where it is now, four pixels, is left out.
    assert (rows.min(), rows.max(), columns.min(), columns.max()) == (15, 24, 10, 13)
    assert np.abs(excess(now, left, ring)).max() < 1e-6
    rendered = now.copy()
    rendered[18, 12] = GREY + np.float32(0.3) * (RED - GREY)  # three tenths of the ball remain
    over = excess(rendered, left, ring)
    assert over.max() == pytest.approx(0.3 * 0.5, abs=1e-6)
    assert (over > 12 / 255).sum() == 1


def test_a_thing_that_stands_leaves_nothing_and_ignored_pixels_are_not_around_it() -> None:
    left, ring = left_and_around(with_ball(10), with_ball(10), EVERYWHERE, None)
    assert not left.any()
    assert not ring.any()
    mask = np.ones((40, 60), np.uint8)
    mask[:15] = 0
    _, ring = left_and_around(with_ball(10), with_ball(40), EVERYWHERE, mask)
    assert ring.any()
    assert not ring[:15].any()


# --- dropping ---
