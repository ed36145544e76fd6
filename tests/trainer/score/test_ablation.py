"""The ablation of the paper's quantisation on real files."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from codec.errors import InvalidError
from codec.lattice.lattice import Lattice
from codec.rig import rig_centre
from codec.slice import Slice
from codec.splats import Splats
from codec.stream import StreamWriter
from tests.support.commands import run_ok
from tests.support.hostile import refused
from tests.support.tiny_capture import seen_by, write_dynamic3dgs
from tests.support.tiny_stream import tiny_manifest
from tests.support.trained_like import trained_like_splats
from trainer.score.ablation import CASES, ablate_quantisation, quantise_case
from trainer.score.evaluate import EvaluateConfig, evaluate_stream

FRAMES, SWIN, SLOTS = 3, 2, (30, 30)
SLICE_SIZE = sum(SLOTS)


def coarse_slice(birth: int, centre: np.ndarray) -> Slice:
    """Clearly visible Gaussians; only their colours fit fp16 without loss."""
    rng = np.random.default_rng(birth + 9)
    splats = Splats(
        (centre + rng.normal(0, 0.7, (SLICE_SIZE, 3))).astype(np.float32),
        rng.normal(-1.5, 0.4, (SLICE_SIZE, 3)).astype(np.float32),
        rng.normal(size=(SLICE_SIZE, 4)).astype(np.float32),
        rng.normal(0, 1, SLICE_SIZE).astype(np.float32),
        (rng.integers(-9, 9, (SLICE_SIZE, 1, 3)) / 8).astype(np.float32),
    )
    return Slice(birth, splats, np.zeros(SLICE_SIZE, np.uint8))


def write_stream(path: Path, capture: Path, case: str = "none", exact: bool = True) -> Path:
    """Writes a stream of Gaussians with the quantisation `case`."""
    manifest = seen_by(tiny_manifest(SWIN, segment_frames=2), capture)
    centre = rig_centre(manifest.cameras)
    assert centre is not None
    lattice = Lattice.suiting(coarse_slice(0, centre).splats)
    manifest = replace(manifest, slots=SLOTS, lattice=(lattice,) * 2, near_m=0.2)
    with StreamWriter.create(path, manifest, exact=exact) as writer:
        for birth in range(1 - SWIN, FRAMES):
            part = coarse_slice(birth, centre)
            writer.append(replace(part, splats=quantise_case(part.splats, case)))
    return path


def test_every_case_quantises_what_it_says_and_scores_like_a_stream_of_it(tmp_path: Path) -> None:
    capture = tmp_path / "capture"
    write_dynamic3dgs(capture, num_cameras=4, num_frames=FRAMES)
    raw = write_stream(tmp_path / "raw", capture)
    words = "swings-eval", raw, capture, "--ablate-quantisation"
    found = json.loads(run_ok(*words, "--json"))
    rows = {row["case"]: row for row in found["rows"]}
    assert (found["frames"], list(rows)) == (FRAMES, list(CASES))
    paper = write_stream(tmp_path / "paper", capture, "all but feat")
    for case, stream in (("none", raw), ("all but feat", paper)):
        whole = evaluate_stream(EvaluateConfig(stream, capture)).layers[-1]
        # A stream cut into layers may be sorted differently, so that sums round differently.
        assert rows[case]["psnr_db"] == pytest.approx(whole.psnr_db, abs=1e-4)
        assert rows[case]["ssim"] == pytest.approx(whole.ssim, abs=1e-5)
    for case, row in rows.items():
        assert row["difference_db"] == pytest.approx(row["psnr_db"] - rows["none"]["psnr_db"])
        # fp16 holds the colours of this stream exactly.
        assert (row["difference_db"] != 0) == (case not in ("none", "feat")), case
    assert {case: (row["raw_bytes"], row["bytes"]) for case, row in rows.items()} == {
        "none": (56, 56), "means": (12, 6), "rotation": (16, 4), "scale": (12, 6), "feat": (12, 6),
        "opacity": (4, 1), "all but feat": (44, 17), "all": (56, 23),
    }  # fmt: skip
    table = run_ok(*words, "--every", 3)
    assert all(case in table for case in CASES)
    quantised = write_stream(tmp_path / "quantised", capture, exact=False)
    says = r"is quantised already.*--raw-stream"
    refused(InvalidError, says, ablate_quantisation, EvaluateConfig(quantised, capture))


def test_numbers_have_the_paper_s_bits() -> None:
    splats = trained_like_splats(200, sh_degree=2)
    found = quantise_case(splats, "all")
    for name in ("means", "log_scales", "sh"):
        assert (getattr(found, name) == getattr(splats, name).astype(np.float16)).all()
    units = splats.quats / np.linalg.norm(splats.quats, axis=1, keepdims=True)
    assert np.abs(found.quats - units).max() <= 1 / 128 + 1e-6
    assert np.abs(found.opacities - splats.opacities).max() <= 1 / 510 + 3e-7
    splats.means[7] = 65520
    refused(InvalidError, "does not fit fp16", quantise_case, splats, "means")
