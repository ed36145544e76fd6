"""Harmonics above what players draw: named, counted as an error, kept unless they are unwanted."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from codec.errors import InvalidError
from codec.interop.formats import SplatFormat, write_splats
from codec.sequence.importing import (
    Imported,
    ImportOptions,
    facing_camera,
    import_stream,
)
from codec.sequence.importscore import with_seen_colours
from codec.splats import SH_C0, Splats
from codec.stream import StreamReader
from codec.tools.audit import describe, summarise
from player.render.cpu import render_splats
from player.streamcommand import draw_poster
from tests.support.commands import run
from tests.support.trained_like import trained_like_splats

COUNT = 400


def save(path: Path, splats: Splats) -> Path:
    path.parent.mkdir(exist_ok=True)
    write_splats(path, splats, SplatFormat.PLY)
    return path


def imported(source: Path, stream: Path, **options: object) -> Imported:
    return import_stream(source, stream, ImportOptions(fps=30, **options), draw_poster)  # type: ignore[arg-type]


@pytest.fixture
def model(tmp_path: Path) -> Path:
    """A file with strong harmonics of degree 3."""
    splats = trained_like_splats(COUNT, sh_degree=3)
    splats.sh[:, 9:] *= 5
    return save(tmp_path / "model.ply", splats)


@pytest.mark.parametrize("sh_degree", [0, 1])
def test_what_players_draw_is_evaluated_as_they_do(sh_degree: int) -> None:
    splats = trained_like_splats(COUNT, sh_degree=sh_degree)
    camera = facing_camera(np.full(3, -3.0), np.full(3, 3.0)).scaled(0.1)
    seen = with_seen_colours(splats, camera.position)
    assert seen.sh_degree == 0
    error = render_splats(seen, camera, 0.01) - render_splats(splats, camera, 0.01)
    assert render_splats(splats, camera, 0.01).std() > 0.05
    assert -10 * np.log10(np.mean(np.square(error, dtype=np.float64)) + 1e-30) > 100


def test_every_degree_counts() -> None:
    """Straight ahead along +z one harmonic of each degree is not zero."""
    splats = trained_like_splats(1, sh_degree=3)
    splats.means[:] = 0, 0, 4
    straight = [0, 2, 6, 12]
    values = SH_C0, 0.4886025119, 2 * 0.3153915653, 2 * 0.3731763326
    for degree in range(4):
        seen = with_seen_colours(splats.with_degree(degree), np.array([0.0, 0.0, -1.0]))
        expected = np.array(values[: degree + 1]) @ splats.sh[0, straight[: degree + 1]]
        assert SH_C0 * seen.sh[0, 0] == pytest.approx(expected, abs=1e-6)


def test_what_is_not_drawn_counts_as_an_error(
    model: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    made = imported(model, tmp_path / "s")
    assert made.source_sh_degree == made.manifest.sh_degree == 3
    assert made.scores_db[0][-1] < 45
    assert StreamReader(tmp_path / "s").records[0].psnr_db[-1] < 45
    [warning] = caplog.messages
    assert warning.startswith("SH degree 3: the players draw harmonics up to degree 1 only")
    assert "--sh-degree 1" in warning


def test_fewer_harmonics_are_fewer_bytes_and_look_the_same(
    model: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    whole = imported(model, tmp_path / "whole")
    caplog.clear()
    less = imported(model, tmp_path / "less", sh_degree=1)
    assert caplog.messages == []
    assert (less.manifest.sh_degree, less.source_sh_degree) == (1, 3)
    assert less.num_bytes < 0.6 * whole.num_bytes
    # Both are compared with the file, which has degree 3.
    assert less.scores_db[0][-1] == pytest.approx(whole.scores_db[0][-1], abs=0.05)


def test_a_degree_is_a_most_and_makes_files_of_several_degrees_one_sequence(tmp_path: Path) -> None:
    folder = tmp_path / "seq"
    for number, sh_degree in enumerate((3, 1, 2)):
        save(folder / f"{number}.ply", trained_like_splats(50, sh_degree=sh_degree))
    with pytest.raises(InvalidError, match=r"1\.ply: SH degree 1, but .* 3; .*--sh-degree 1 "):
        imported(folder, tmp_path / "s")
    made = imported(folder, tmp_path / "s", sh_degree=1)
    assert (made.manifest.sh_degree, made.source_sh_degree) == (1, 3)
    plain = save(tmp_path / "plain.ply", trained_like_splats(50))
    assert imported(plain, tmp_path / "p", sh_degree=3).manifest.sh_degree == 0
    with pytest.raises(InvalidError, match="sh-degree 4: choose 0 to 3"):
        ImportOptions(sh_degree=4)


def test_of_degree_one_nothing_is_lost(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    model = save(tmp_path / "model.ply", trained_like_splats(COUNT, sh_degree=1))
    assert imported(model, tmp_path / "s", exact=True).scores_db[0][-1] == 100
    assert caplog.messages == []
    assert "colour       SH degree 1\n" in describe(summarise(tmp_path / "s"))


def test_the_commands_say_so(model: Path, tmp_path: Path) -> None:
    done = run("swings-stream", "import", model, tmp_path / "s")
    assert done.returncode == 0
    [warning] = done.stderr.splitlines()
    assert "SH degree 3: the players draw harmonics up to degree 1" in warning
    assert "the files at SH degree 3, the stream at 1 as players draw it" in done.stdout
    assert (
        "colour       SH degree 3, of which players draw degree 1; exports keep all\n"
        in describe(summarise(tmp_path / "s"))
    )
    done = run("swings-stream", "import", model, tmp_path / "t", "--sh-degree", 4)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == "swings-stream: sh-degree 4: choose 0 to 3\n"
