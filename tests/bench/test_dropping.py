"""Gaussians dropped by rank, compared with the stream's own layers: scores, bytes and plots."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from rich.console import Console

from bench.dropping import (
    BY_CONTRIBUTION,
    BY_OPACITY,
    LAYERS,
    DroppingConfig,
    Outcome,
    at_same_bytes,
    draw,
    draw_sheet,
    measure,
    table_of,
    training_views,
)
from codec.errors import InvalidError
from tests.bench.scored_stream import FRAMES, write_scored
from tests.support.tiny_capture import picture_of
from trainer.score.evaluate import EvaluateConfig, evaluate_stream
from trainer.score.truth import open_held_out


def written(path: Path, swin_size: int = 2) -> DroppingConfig:
    stream, capture = write_scored(path, swin_size)
    plots = path / "plots"
    return DroppingConfig(
        stream, capture, plots / "a.png", plots / "a.jpg", every=2, views=2, frame=3
    )


@pytest.mark.parametrize("swin_size", [1, 2])
def test_it_measures_and_draws(swin_size: int, tmp_path: Path) -> None:
    config = written(tmp_path, swin_size)
    found = measure(config)
    layers = evaluate_stream(EvaluateConfig(config.stream, config.capture, every=2)).layers
    of_layers = [(score.psnr_db, score.bytes_per_frame) for score in reversed(layers)]
    assert [(o.psnr_db, o.bytes_per_frame) for o in found.of(LAYERS)] == of_layers
    assert [o.name for o in found.of(LAYERS)] == ["2 layers", "1 layer"]
    assert len({o.psnr_db for o in found.outcomes}) > 3
    for chosen in (BY_OPACITY, BY_CONTRIBUTION):
        whole, *less = found.of(chosen)
        assert (whole.psnr_db, whole.bytes_per_frame) == of_layers[0]
        sizes = [o.bytes_per_frame for o in (whole, *less)]
        assert sizes == sorted(set(sizes), reverse=True)
        assert [o.share for o in (whole, *less)] == [1, 0.8, 0.6, 0.4, 0.2]
    assert found.truth_name == "camera cam01, frame 3"
    assert (found.truth == picture_of(1, 3)).all()
    console = Console(width=110)
    with console.capture() as shown:
        console.print(table_of(found))
    rows = [line.split("|")[1:-1] for line in shown.get().splitlines() if "%" in line]
    for row, outcome in zip(rows, found.outcomes, strict=True):
        assert row[1].strip() == f"{outcome.share:.0%}"
        expected = [outcome.bytes_per_frame / 1e3, outcome.psnr_db]
        assert [float(row[i]) for i in (2, 3)] == pytest.approx(expected, abs=0.06)
    draw(found, config.out)
    draw_sheet(found, config.sheet)
    assert config.out.read_bytes().startswith(b"\x89PNG")
    with Image.open(config.sheet) as sheet:
        assert sheet.format == "JPEG"
        assert 1280 <= sheet.width <= 1600
    assert config.sheet.stat().st_size < 600_000


def test_no_held_out_camera_ranks(tmp_path: Path) -> None:
    config = written(tmp_path)
    with open_held_out(config.stream, config.capture) as held_out:
        names = [view.camera.name for view in training_views(held_out)]
    assert names == ["cam00", "cam02", "cam03"]


def outcome(num_bytes: float, psnr_db: float) -> Outcome:
    nothing = np.zeros((1, 1, 3), np.uint8)
    return Outcome(BY_OPACITY, "", 1, num_bytes, psnr_db, nothing, psnr_db)


def test_what_as_many_bytes_give_lies_between_the_points() -> None:
    line = [outcome(400, 30), outcome(100, 20)]
    assert at_same_bytes(line, 400) == pytest.approx(30)
    assert at_same_bytes(line, 200) == pytest.approx(25)
    assert at_same_bytes(line, 100) == pytest.approx(20)
    assert at_same_bytes(line, 99) is None
    assert at_same_bytes(line, 401) is None


def test_options_out_of_their_bounds_are_refused(tmp_path: Path) -> None:
    config = written(tmp_path)
    for wrong, message in (
        (replace(config, shares=()), "at least one share"),
        (replace(config, shares=(0.5, 1.1)), "at most 1"),
        (replace(config, views=0), "views 0"),
        (replace(config, every=0), "every 0"),
        (replace(config, frame=FRAMES), f"frames 0:{FRAMES}, not {FRAMES}"),
        (replace(config, camera="cam00"), "'cam00' is not held out; choose cam01"),
    ):
        with pytest.raises(InvalidError, match=message):
            measure(wrong)
