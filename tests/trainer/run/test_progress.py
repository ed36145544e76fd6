"""Progress of a training run: its log, and one line in a terminal, or plain lines at intervals."""

from __future__ import annotations

import io
import json
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from rich.console import Console

from codec.errors import InvalidError
from codec.progressline import ProgressLine, line_of
from tests.support.commands import run
from trainer.fit.config import FitConfig
from trainer.fit.observer import Progress as FitProgress
from trainer.run.monitor import Monitor, RunLog, RunStatus

TINY = (
    "--num-gs", 100, "--genesis-iterations", 40, "--settle-rounds", 1, "--window-iterations", 20,
    "--frames", "0:2",
)  # fmt: skip


def test_time_left_is_that_of_the_iterations_left(tmp_path: Path) -> None:
    meter: Any = SimpleNamespace(mean_db=25.5)
    now_s = [100.0]
    config = FitConfig(num_gs=10, genesis_iterations=150, settle_rounds=1, window_iterations=50)
    told = io.StringIO()
    line = ProgressLine(Console(file=told), lambda: now_s[0])
    with RunLog(tmp_path / "log") as log, line:
        monitor = Monitor(line, log, config, 5, lambda: now_s[0], (960, 540))
        now_s[0] += 7  # before training begins
        monitor.window_begun(0, 100)  # a checkpoint had 100, which took none of the time
        monitor.progressed(FitProgress(0, 200, 200, 0.25))
        now_s[0] += 20  # 100 iterations in 20 s; 200 are left
        monitor.frame_finished(0, 10, 0, meter)
        monitor.window_begun(1, 0)
        now_s[0] += 10  # 50 in 10 s; 150 in 30 s so far; 150 are left
        monitor.frame_finished(1, 10, 4000, meter)
    first, second = (json.loads(line) for line in (tmp_path / "log").read_text().splitlines())
    assert (first["left_s"], first["iterations_per_s"], first["loss"]) == (40, 5, 0.25)
    assert (second["left_s"], second["iterations_per_s"]) == (30, 5)
    assert (second["bytes_per_frame"], second["psnr_db"]) == (2000, 25.5)
    assert told.getvalue().splitlines()[-1] == (
        "frame 1 of 5  62% done  0:30 elapsed, 0:30 left  25.50 dB  2.0 kB/frame  5 it/s"
    )
    for _ in range(2):  # said once
        now_s[0] += 2000
        monitor.progressed(FitProgress(2, 1, 50, 0.25))
    (long,) = (text for text in told.getvalue().splitlines() if "longest-px" in text)
    assert (
        long == "at 960x540 pixels this takes about 1:07:13; --longest-px 480 takes about a quarter"
    )


def test_tensorboard_gets_the_scalars_or_says_what_to_install(tmp_path: Path) -> None:
    try:
        import tensorboardX
    except ImportError:
        with pytest.raises(InvalidError, match=r"pip install '\.\[tensorboard\]'"):
            RunLog(tmp_path / "log", tmp_path / "board")
        return
    assert tensorboardX.__version__
    with RunLog(tmp_path / "log", tmp_path / "board") as log:
        log.add({"frame": 3, "psnr_db": 25.0, "note": None})
    assert any(f.stat().st_size for f in (tmp_path / "board").iterdir())


def test_a_usual_line_fits_80_columns_with_all_that_is_known() -> None:
    usual = RunStatus(149, 150, 0.383, 754, 1234, 28.412, 33_123, 106.5).stage()
    assert line_of(usual, 80) == (
        "frame 149 of 150  38% done  12:34 elapsed, 20:34 left  28.41 dB  33.1 kB/frame"
    )


def test_a_run_whose_output_is_a_file_says_how_it_goes(capture: Path, tmp_path: Path) -> None:
    done = run("swings-train", capture, tmp_path / "stream", *TINY)
    assert done.returncode == 0, done.stderr
    assert "compiling" not in done.stderr  # the kernels are there
    lines = [line for line in done.stderr.splitlines() if " done" in line]
    assert lines[0].startswith("first of 2 frames")
    assert lines[-1].startswith("frame 1 of 2  100% done")
    assert lines[-1].endswith("it/s")
    figures, watch, score = done.stderr.splitlines()[-3:]
    assert re.fullmatch(
        r".*stream: 2 frames, [\d.]+ dB, [\d.]+ kB a frame, [\d.]+ Mbit/s; this run took \d+:\d\d",
        figures,
    )
    assert watch == f"to watch it: swings-serve {tmp_path / 'stream'}"
    assert score.startswith(f"to score it: swings-eval {tmp_path / 'stream'} '{capture}' ")
    assert " dB  " in lines[-1]
    assert all(len(line) <= 80 and line.isprintable() for line in lines)
