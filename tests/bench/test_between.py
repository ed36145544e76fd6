"""Pictures between frames, measured: held, faded and interpolated."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from bench.play.between import (
    FADED,
    HELD,
    INTERPOLATED,
    SENT,
    BetweenConfig,
    against_film,
    against_stream,
    table_of,
)
from codec.errors import InvalidError
from codec.stream import StreamReader
from tests.bench.scored_stream import NEAR, write_scored
from tests.player.render.test_glide import write_body


def test_what_moves_straight_is_interpolated_best(tmp_path: Path) -> None:
    write_body(tmp_path / "s")
    reader = StreamReader(tmp_path / "s")
    config = BetweenConfig(tmp_path / "s", pictures=3)
    near, far = (against_stream(reader, gap, config) for gap in (2, 4))
    for scores in (near, far):
        assert min(scores.goes_on) > 0.9  # small Gaussians jump
        assert len(scores.whole[HELD]) == 3 * len(reader.manifest.cameras[:2])
        by = {how: np.mean(found) for how, found in scores.changing.items()}
        assert by[INTERPOLATED] > by[FADED] + 6 > by[HELD] + 6
    assert np.mean(far.whole[HELD]) < np.mean(near.whole[HELD])


def test_both_tables_are_printed(tmp_path: Path) -> None:
    stream, capture = write_scored(tmp_path)
    config = BetweenConfig(stream, capture, gaps=(2,))
    film = against_film(config)
    assert set(film.whole) == {HELD, FADED, INTERPOLATED, SENT}
    assert len(film.goes_on) == 2
    console = Console(width=160)
    with console.capture() as shown:
        console.print(table_of("against the film", {"2 frames": film}, (SENT, HELD)))
    row = next(line for line in shown.get().splitlines() if "2 frames" in line)
    cells = [cell.strip() for cell in row.split("|")]
    assert float(cells[2]) == pytest.approx(np.mean(film.whole[SENT]), abs=0.006)


def test_a_camera_has_its_own_near_plane(tmp_path: Path) -> None:
    tables = []
    for name, changes in NEAR.items():
        stream, capture = write_scored(tmp_path / name, **changes)
        config = BetweenConfig(stream, capture, pictures=2)
        tables.append((against_stream(StreamReader(stream), 2, config), against_film(config)))
    every, own, none = tables
    assert own == every
    assert own[0] != none[0]
    assert own[1] != none[1]


@pytest.mark.parametrize("gap", [1, 3, 100])
def test_a_gap_that_has_no_middle_or_is_too_long_is_refused(tmp_path: Path, gap: int) -> None:
    write_body(tmp_path / "s")
    with pytest.raises(InvalidError, match=r"gap \d+"):
        against_stream(StreamReader(tmp_path / "s"), gap, BetweenConfig(tmp_path / "s"))
