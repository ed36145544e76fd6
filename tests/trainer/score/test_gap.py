"""swings-eval --training-cameras: training cameras of a stream beside the held-out ones."""

from __future__ import annotations

import json
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from codec.stream import StreamReader
from tests.support.commands import run, run_ok
from tests.support.tiny_capture import write_dynerf
from trainer.capture.layout import open_capture
from trainer.score.picture import captured, displayed
from trainer.step.loss import psnr_db

FRAMES = 3


def test_the_gap_is_what_the_decoded_files_show_from_both_sides(tmp_path: Path) -> None:
    capture, stream = tmp_path / "capture", tmp_path / "stream"
    write_dynerf(capture, 6, FRAMES)
    (capture / "held_out.txt").write_text("cam01\ncam03\n")
    run_ok(
        "swings-train", capture, stream, "--num-gs", 200, "--genesis-iterations", 40,
        "--settle-rounds", 1, "--window-iterations", 5,
    )  # fmt: skip
    scores = json.loads(run_ok("swings-eval", stream, capture, "--training-cameras", "--json"))
    training, held_out = scores["gap"]["training"], scores["gap"]["held_out"]
    best = scores["layers"][-1]
    for name in ("psnr_db", "fitted_psnr_db", "moving_psnr_db", "fitted_moving_psnr_db"):
        assert held_out[name] == pytest.approx(best[name])
    reader, footage = StreamReader(stream), open_capture(capture)
    assert len(footage.training) == 4
    for frame in range(FRAMES):
        splats = reader.active_splats(frame, reader.manifest.num_layers)
        found_db = []
        for index in footage.training:
            camera = footage.cameras[index].camera
            shown = displayed(splats, camera, reader.manifest.near_m)
            with closing(footage.open_images(index)) as pictures:
                found_db.append(psnr_db(shown, captured(pictures.read(frame))))
        assert training["per_frame_psnr_db"][frame] == pytest.approx(np.mean(found_db))
    assert training["fitted_psnr_db"] >= training["psnr_db"]
    table = run_ok("swings-eval", stream, capture, "--training-cameras")
    gap_db = training["psnr_db"] - held_out["psnr_db"]
    [line] = [line for line in table.splitlines() if line.startswith("│ gap")]
    assert f"{gap_db:.2f}" in line


def test_the_gap_goes_with_scores_only(tmp_path: Path) -> None:
    for other in (["--ablate-quantisation"], ["--compare", "cam00", str(tmp_path / "x.mp4")]):
        result = run("swings-eval", tmp_path, tmp_path, "--training-cameras", *other)
        assert result.returncode == 2
        assert "leave out" in result.stderr
