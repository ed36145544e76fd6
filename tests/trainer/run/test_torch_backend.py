"""Training by plain torch gives the same stream as training by numba, except for rounding."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from rich.console import Console

from tests.support.commands import run, run_ok
from trainer.score.evaluate import EvaluateConfig, evaluate_stream
from trainer.synth.film import SynthConfig, synthesise

SETTINGS = (
    "--num-gs", 500, "--point-share", 0.8, "--genesis-iterations", 200, "--settle-rounds", 0,
    "--window-iterations", 30, "--segment-frames", 2,
)  # fmt: skip
FILM = SynthConfig(
    Path("unset"), frames=3, cameras=14, held_out=1, width_px=64, height_px=48, points=400
)


def test_a_stream_trained_by_torch_is_valid_and_as_good(tmp_path: Path) -> None:
    capture = tmp_path / "capture"
    synthesise(replace(FILM, out=capture), Console(quiet=True))
    psnr_db = {}
    for name in ("cpu", "torch"):
        stream = tmp_path / name
        done = run("swings-train", capture, stream, "--backend", name, *SETTINGS)
        assert done.returncode == 0, done.stderr
        assert f"backend: {'cpu (numba)' if name == 'cpu' else 'torch on '}" in done.stderr
        run_ok("swings-stream", "verify", stream)
        psnr_db[name] = evaluate_stream(EvaluateConfig(stream, capture)).layers[-1].psnr_db
    assert psnr_db["cpu"] > 15
    assert psnr_db["torch"] == pytest.approx(psnr_db["cpu"], abs=0.2)
