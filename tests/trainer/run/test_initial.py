"""swings-train --initial: a first frame from another training."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from codec.interop.formats import SplatFormat, read_splats, write_splats
from codec.stream import StreamReader
from tests.support.commands import run, run_ok
from tests.support.tiny_capture import write_dynerf
from trainer.run.runlog import LOG_NAME

FRAMES = 3
LATER = "--window-iterations", 20, "--num-gs", 200


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A capture, a stream of it, and the stream's first frame as a file."""
    root = tmp_path_factory.mktemp("initial")
    write_dynerf(root / "capture", 4, FRAMES)
    arguments = "--genesis-iterations", 150, "--settle-rounds", 2, *LATER
    run_ok("swings-train", root / "capture", root / "first", *arguments)
    run_ok("swings-stream", "export", root / "first", root / "first.ply", "--frame", 0)
    return root


def scores(stream: Path) -> list[float]:
    lines = (stream / LOG_NAME).read_text().splitlines()
    return [json.loads(line)["psnr_db"] for line in lines]


def test_a_run_goes_on_from_given_gaussians(trained: Path, tmp_path: Path) -> None:
    initial = trained / "first.ply"
    count = len(read_splats(initial))
    run_ok(
        "swings-train", trained / "capture", tmp_path / "s", *LATER, "--num-gs", count,
        "--initial", initial, "--genesis-iterations", 0, "--settle-rounds", 1,
    )  # fmt: skip
    assert StreamReader(tmp_path / "s").num_frames == FRAMES
    # 20 iterations cannot train 200 seeds.
    assert scores(tmp_path / "s")[0] > scores(trained / "first")[0] - 0.5


def test_colours_of_a_higher_degree_are_cut(trained: Path, tmp_path: Path) -> None:
    splats = read_splats(trained / "first.ply").with_degree(3)
    write_splats(tmp_path / "three.ply", splats, SplatFormat.PLY)
    assert read_splats(tmp_path / "three.ply").sh_degree == 3
    run_ok(
        "swings-train", trained / "capture", tmp_path / "s", *LATER, "--num-gs", len(splats),
        "--initial", tmp_path / "three.ply", "--genesis-iterations", 0, "--settle-rounds", 1,
    )  # fmt: skip
    assert StreamReader(tmp_path / "s").manifest.sh_degree == 0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--initial", "first.ply", "--num-gs", 300), "set --num-gs"),
        (("--initial", "none.ply"), "none.ply"),
        (("--genesis-iterations", 0), "see --initial"),
        (("--genesis-iterations", 0, "--settle-rounds", 0), "leave nothing to train"),
    ],
)
def test_what_cannot_begin_is_said_before_anything_is_written(
    trained: Path, tmp_path: Path, arguments: tuple[object, ...], message: str
) -> None:
    named = [trained / str(a) if str(a).endswith(".ply") else a for a in arguments]
    done = run("swings-train", trained / "capture", tmp_path / "s", *named)
    assert done.returncode != 0
    assert message in " ".join(done.stderr.split())
    assert not (tmp_path / "s").exists()
