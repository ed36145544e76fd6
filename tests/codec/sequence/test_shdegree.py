"""Harmonics of every degree: kept unless excluded, and included in the PSNR."""

from __future__ import annotations

from pathlib import Path

import pytest

from codec.errors import InvalidError
from codec.interop.formats import SplatFormat, write_splats
from codec.sequence.errorbound import HOLD, KINDS, ErrorBound, steps_of
from codec.sequence.importing import Imported, ImportOptions, import_stream
from codec.splats import Splats
from codec.stream import StreamReader
from codec.tools.audit import describe, summarise
from player.streamcommand import draw_poster
from tests.support.commands import run
from tests.support.deforming import Deforming
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


def test_every_degree_counts(model: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    exact = imported(model, tmp_path / "exact", exact=True)
    assert exact.source_sh_degree == exact.manifest.sh_degree == 3
    assert exact.scores_db[0][-1] == 100
    less = imported(model, tmp_path / "less", exact=True, sh_degree=1)
    assert (less.manifest.sh_degree, less.source_sh_degree) == (1, 3)
    # The file is drawn with all its harmonics.
    assert less.scores_db[0][-1] < 45
    assert StreamReader(tmp_path / "less").records[0].psnr_db[-1] < 45
    assert less.num_bytes < 0.6 * exact.num_bytes
    assert caplog.messages == []


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


def test_the_command_says_so(model: Path, tmp_path: Path) -> None:
    done = run("swings-stream", "import", model, tmp_path / "l", "--sh-degree", 1)
    assert (done.returncode, done.stderr) == (0, "")
    assert "the files at SH degree 3, the stream at 1\n" in done.stdout
    assert "colour       SH degree 1\n" in describe(summarise(tmp_path / "l"))
    done = run("swings-stream", "import", model, tmp_path / "t", "--sh-degree", 4)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == "swings-stream: sh-degree 4: choose 0 to 3\n"


def test_errors_go_by_what_is_seen_of_them(tmp_path: Path) -> None:
    """With harmonics of degree 3, pictures get better, and moving frames do not get larger."""
    deforming = Deforming(3000, 3)
    for number in range(3):
        save(tmp_path / "seq" / f"{number}.ply", deforming.next())
    evenly = imported(tmp_path / "seq", tmp_path / "evenly", by_paint=False)
    made = imported(tmp_path / "seq", tmp_path / "made")
    assert len(set(evenly.manifest.lattice)) == 1
    position_m = [lattice.position_m for lattice in made.manifest.lattice]
    assert position_m == sorted(position_m)
    assert position_m[-1] > 2 * position_m[0]
    assert made.scores_db[0][-1] > evenly.scores_db[0][-1] + 3
    moved = [one.played_bytes - one.first_bytes for one in (made, evenly)]
    assert moved[0] < 1.05 * moved[1]
    for number, kind in enumerate(KINDS):
        steps = [steps_of(lattice)[number] for lattice in made.manifest.lattice]
        assert made.errors[kind] <= HOLD * max(steps) * (1 + 1e-4)


def test_few_harmonics_keep_the_errors_of_each_gaussian(tmp_path: Path) -> None:
    deforming = Deforming(200, 1)
    for number in range(2):
        save(tmp_path / "seq" / f"{number}.ply", deforming.next())
    made = imported(tmp_path / "seq", tmp_path / "made")
    assert len(set(made.manifest.lattice)) == 1
    assert made.manifest.lattice[0].colour == pytest.approx(ErrorBound().colour / HOLD)
