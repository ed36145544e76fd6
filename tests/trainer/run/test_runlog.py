"""Other output of a training run: its log, scalars and snapshots."""

from __future__ import annotations

import io
import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from rich.console import Console

from codec.errors import InvalidError
from codec.progressline import ProgressLine
from tests.support.commands import run, run_ok
from tests.support.tiny_capture import write_dynerf
from trainer.fit.config import FitConfig
from trainer.fit.observer import Progress as FitProgress
from trainer.run.monitor import Monitor
from trainer.run.runlog import LOG_NAME, RunLog
from trainer.score.meter import QualityMeter

FRAMES = 5


def test_a_log_without_a_place_is_refused_before_training(tmp_path: Path) -> None:
    write_dynerf(tmp_path / "capture", 4, 2)
    log = tmp_path / "nowhere" / "log.jsonl"
    done = run("swings-train", tmp_path / "capture", tmp_path / "out", "--log", log)
    assert done.returncode == 1
    assert "nowhere is not a folder" in done.stderr
    assert not (tmp_path / "out").exists()


def test_a_run_logs_every_frame_and_draws_snapshots(tmp_path: Path) -> None:
    write_dynerf(tmp_path / "capture", 4, FRAMES)
    stream = tmp_path / "stream"
    xyz = np.random.default_rng(0).uniform(-0.5, 0.5, (50, 3))
    np.savez(tmp_path / "points.npz", xyz=xyz, rgb=np.full((50, 3), 99, np.uint8))
    run_ok(
        "swings-train", tmp_path / "capture", stream, "--num-gs", 200, "--swin-size", 2,
        "--genesis-iterations", 30, "--settle-rounds", 1, "--window-iterations", 20,
        "--segment-frames", 2,
        "--snapshot-every", 2, "--points", tmp_path / "points.npz",
    )  # fmt: skip
    records = [json.loads(line) for line in (stream / LOG_NAME).read_text().splitlines()]
    assert [r["frame"] for r in records] == list(range(FRAMES))
    assert all(r["gaussians"] > 100 for r in records)
    assert all(r["iterations_per_s"] > 0 for r in records)
    assert records[-1]["left_s"] == 0 < records[0]["left_s"]
    assert records[-1]["psnr_db"] > 5
    # Bytes of the complete segments, without snapshots except those of frame 0.
    for frame in (1, 3):
        played = sum(
            file.stat().st_size
            for segment in range(frame // 2 + 1)
            for file in (stream / "segments" / str(segment)).iterdir()
            if segment == 0 or not file.name.startswith("snapshot")
        )
        assert records[frame]["bytes_per_frame"] == round(played / (frame + 1))
    assert any((stream / "segments" / "1").glob("snapshot-*"))
    assert sorted(p.name for p in (stream / "snapshots").iterdir()) == [
        f"{frame:06d}.png" for frame in (0, 2, 4)
    ]
    with Image.open(stream / "snapshots" / "000004.png") as picture:
        drawn = np.asarray(picture)
    height, width = drawn.shape[:2]
    captured, rendered = drawn[:, : width // 3], drawn[:, width // 3 : 2 * width // 3]
    assert captured.std() > 1
    assert rendered.std() > 1
    assert height > 10


def test_time_left_is_that_of_the_iterations_left(tmp_path: Path) -> None:
    class Meter(QualityMeter):
        def __init__(self) -> None:
            pass

        @property
        def mean_db(self) -> float:
            return 25.5

    now_s = [100.0]
    config = FitConfig(num_gs=10, genesis_iterations=150, settle_rounds=1, window_iterations=50)
    told = io.StringIO()
    line = ProgressLine(Console(file=told), lambda: now_s[0])
    with RunLog(tmp_path / "log") as log, line:
        monitor = Monitor(line, log, config, 5, lambda: now_s[0])
        now_s[0] += 7  # before training begins
        monitor.window_begun(0, 0)
        monitor.progressed(FitProgress(0, 200, 200, 0.25))
        now_s[0] += 20  # 200 iterations in 20 s; 200 are left
        monitor.frame_finished(0, 10, 0, Meter())
        monitor.window_begun(1, 0)
        now_s[0] += 10  # 50 in 10 s; 250 in 30 s so far; 150 are left
        monitor.frame_finished(1, 10, 4000, Meter())
    first, second = (json.loads(line) for line in (tmp_path / "log").read_text().splitlines())
    assert (first["left_s"], first["iterations_per_s"], first["loss"]) == (20, 10, 0.25)
    assert (second["left_s"], second["iterations_per_s"]) == (18, 5)
    assert (second["bytes_per_frame"], second["psnr_db"]) == (2000, 25.5)
    assert told.getvalue().splitlines()[-1] == (
        "frame 1 of 5  62% done  0:30 elapsed, 0:18 left  25.50 dB  2.0 kB/frame  5 it/s"
    )


def test_iterations_that_a_checkpoint_had_took_none_of_the_time(tmp_path: Path) -> None:
    now_s, told = 100.0, io.StringIO()
    config = FitConfig(num_gs=10, genesis_iterations=150, settle_rounds=1, window_iterations=50)
    with RunLog(tmp_path / "log") as log, ProgressLine(Console(file=told), lambda: now_s) as line:
        monitor = Monitor(line, log, config, 5, lambda: now_s)
        monitor.window_begun(0, 100)  # of 200, and 200 more
        now_s += 10
        monitor.progressed(FitProgress(0, 150, 200, 0.25))
    assert "38% done  0:10 elapsed, 0:50 left" in told.getvalue().splitlines()[-1]


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
