"""The ablation of the quantisation: one attribute at a time, on real files with exact floats."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from codec.errors import InvalidError
from codec.lattice.lattice import Lattice
from codec.rig import rig_centre
from codec.slice import Slice
from codec.splats import Splats, sh_count
from codec.stream import StreamWriter
from tests.support.commands import run, run_ok
from tests.support.tiny_capture import seen_by, write_dynamic3dgs
from tests.support.tiny_stream import tiny_manifest
from trainer.score.ablation import CASES, Ablation, ablate_quantisation, quantise_case
from trainer.score.evaluate import EvaluateConfig, evaluate_stream

FRAMES, SWIN, SLOTS = 3, 2, (30, 30)
SLICE_SIZE = sum(SLOTS)


def coarse_slice(birth: int, centre: np.ndarray, sh_degree: int) -> Slice:
    """Clearly visible Gaussians; only their colours fit fp16 without loss."""
    rng = np.random.default_rng(birth + 9)
    splats = Splats(
        (centre + rng.normal(0, 0.7, (SLICE_SIZE, 3))).astype(np.float32),
        rng.normal(-1.5, 0.4, (SLICE_SIZE, 3)).astype(np.float32),
        rng.normal(size=(SLICE_SIZE, 4)).astype(np.float32),
        rng.normal(0, 1, SLICE_SIZE).astype(np.float32),
        (rng.integers(-9, 9, (SLICE_SIZE, sh_count(sh_degree), 3)) / 8).astype(np.float32),
    )
    return Slice(birth, splats, np.zeros(SLICE_SIZE, np.uint8))


@dataclass(frozen=True)
class Made:
    """A capture, and streams of the same Gaussians: exact ones, of which one is quantised as in the
    paper and one has colours of degree 1, and one on a lattice."""

    capture: Path
    raw: Path
    paper: Path
    quantised: Path
    raw_sh1: Path


def write_stream(
    path: Path, capture: Path, case: str = "none", sh_degree: int = 0, exact: bool = True
) -> Path:
    """Writes a stream of Gaussians with the quantisation `case`."""
    manifest = seen_by(tiny_manifest(SWIN, segment_frames=2), capture)
    centre = rig_centre(manifest.cameras)
    assert centre is not None
    lattice = Lattice.suiting(coarse_slice(0, centre, sh_degree).splats)
    manifest = replace(
        manifest, slots=SLOTS, lattice=(lattice,) * 2, sh_degree=sh_degree, near_m=0.2
    )
    with StreamWriter.create(path, manifest, exact=exact) as writer:
        for birth in range(1 - SWIN, FRAMES):
            part = coarse_slice(birth, centre, sh_degree)
            writer.append(replace(part, splats=quantise_case(part.splats, case)))
    return path


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Made:
    root = tmp_path_factory.mktemp("ablation")
    capture = root / "capture"
    write_dynamic3dgs(capture, num_cameras=4, num_frames=FRAMES)
    return Made(
        capture,
        write_stream(root / "raw", capture),
        write_stream(root / "paper", capture, "all but feat"),
        write_stream(root / "quantised", capture, exact=False),
        write_stream(root / "sh1", capture, sh_degree=1),
    )


@pytest.fixture(scope="module")
def ablation(made: Made) -> Ablation:
    return ablate_quantisation(EvaluateConfig(made.raw, made.capture))


def test_none_and_the_papers_choice_are_what_the_streams_score(
    ablation: Ablation, made: Made
) -> None:
    rows = {row.case: row for row in ablation.rows}
    for case, stream in (("none", made.raw), ("all but feat", made.paper)):
        whole = evaluate_stream(EvaluateConfig(stream, made.capture)).layers[-1]
        # A stream cut into layers may be sorted differently, so that sums round differently.
        assert rows[case].psnr_db == pytest.approx(whole.psnr_db, abs=1e-4)
        assert rows[case].ssim == pytest.approx(whole.ssim, abs=1e-5)
    assert rows["none"].psnr_db != rows["all but feat"].psnr_db


def test_each_row_quantises_what_it_says(ablation: Ablation) -> None:
    rows = {row.case: row for row in ablation.rows}
    assert list(rows) == list(CASES)
    none = rows["none"].psnr_db
    for row in ablation.rows:
        assert row.difference_db == pytest.approx(row.psnr_db - none)
        assert abs(row.difference_db) < 0.5
        # fp16 holds the colours of this stream exactly.
        changes = row.case not in ("none", "feat")
        assert (row.difference_db != 0) == changes, row
    assert rows["all"].psnr_db == rows["all but feat"].psnr_db
    assert len({row.psnr_db for row in ablation.rows}) == len(CASES) - 2


def test_the_bytes_are_those_of_section_5_6_2(ablation: Ablation, made: Made) -> None:
    sizes = {row.case: (row.raw_bytes, row.bytes) for row in ablation.rows}
    assert sizes == {
        "none": (56, 56),
        "means": (12, 6),
        "rotation": (16, 4),
        "scale": (12, 6),
        "feat": (12, 6),
        "opacity": (4, 1),
        "all but feat": (44, 17),
        "all": (56, 23),
    }
    rows = ablate_quantisation(EvaluateConfig(made.raw_sh1, made.capture, every=3)).rows
    assert [(r.raw_bytes, r.bytes) for r in rows if r.case in ("feat", "none")] == [
        (92, 92),
        (48, 24),
    ]


def test_the_command_prints_a_table_and_json(ablation: Ablation, made: Made) -> None:
    arguments = (made.raw, made.capture, "--ablate-quantisation")
    found = json.loads(run_ok("swings-eval", *arguments, "--json"))
    assert found["frames"] == FRAMES
    assert found["cameras"] == ablation.cameras
    assert [row["case"] for row in found["rows"]] == list(CASES)
    for row, expected in zip(found["rows"], ablation.rows, strict=True):
        assert row["psnr_db"] == pytest.approx(expected.psnr_db, abs=1e-4)
    table = run_ok("swings-eval", *arguments, "--every", 3)
    assert "1 frames" in table
    assert all(case in table for case in CASES)


def test_what_cannot_be_ablated_is_one_line(made: Made) -> None:
    done = run("swings-eval", made.quantised, made.capture, "--ablate-quantisation")
    assert done.returncode == 1
    (line,) = done.stderr.strip().splitlines()
    assert line.startswith("swings-eval: ")
    assert f"{made.quantised} is quantised already" in line
    assert "--raw-stream" in line
    for score in (evaluate_stream, ablate_quantisation):
        with pytest.raises(InvalidError, match="every 0: choose 1 or more"):
            score(EvaluateConfig(made.raw, made.capture, every=0))
