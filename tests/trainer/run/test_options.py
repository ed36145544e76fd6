"""What options of swings-train make of a stream."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from codec.errors import SwingsError
from codec.interop.formats import SplatFormat, read_splats, write_splats
from codec.stream import StreamReader
from codec.tools.audit import verify_stream
from tests.support.commands import run
from tests.support.tiny_capture import WIDTH_PX
from tests.support.trainings import train_here
from trainer.run.monitor import LOG_NAME

FRAMES = 6
LATER = "--window-iterations", 10, "--num-gs", 200, "--frames", "0:2"


def log_of(stream: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (stream / LOG_NAME).read_text().splitlines()]


def test_runs_go_on_from_given_gaussians_of_a_higher_degree(capture: Path, tmp_path: Path) -> None:
    first, initial = tmp_path / "first", tmp_path / "first.ply"
    train_here(capture, first, *LATER, "--genesis-iterations", 150, "--settle-rounds", 2)
    reader = StreamReader(first)
    splats = reader.active_splats(0, reader.manifest.num_layers)
    write_splats(initial, splats.with_degree(3), SplatFormat.PLY)
    assert read_splats(initial).sh_degree == 3
    given = "--initial", initial, "--genesis-iterations", 0, "--settle-rounds", 1
    train_here(capture, tmp_path / "s", *LATER, "--num-gs", len(splats), *given)
    assert StreamReader(tmp_path / "s").manifest.sh_degree == 0
    # 10 iterations cannot train 200 seeds.
    assert log_of(tmp_path / "s")[0]["psnr_db"] > log_of(first)[0]["psnr_db"] - 0.5
    with pytest.raises(SwingsError, match="set --num-gs"):
        train_here(capture, tmp_path / "other", *given, "--num-gs", 300)


def test_what_cannot_begin_is_refused_before_any_write(capture: Path, tmp_path: Path) -> None:
    for option, value, message in (
        ("--initial", "none.ply", r"none\.ply"),
        ("--default-camera", "nobody", "has no such camera; it has cam00, "),
        ("--genesis-iterations", 0, "see --initial"),
        ("--log", "nowhere/log.jsonl", "nowhere is not a folder"),
    ):
        with pytest.raises((SwingsError, OSError), match=message):
            train_here(capture, tmp_path / "s", option, value)
    assert not (tmp_path / "s").exists()


def test_preset_gpu_says_memory_and_scales_large_captures(capture: Path, tmp_path: Path) -> None:
    stream = tmp_path / "stream"
    done = run(
        "swings-train", capture, stream, "--preset", "gpu", "--num-gs", 100, "--frames", "0:2",
        "--genesis-iterations", 5, "--settle-rounds", 1, "--window-iterations", 2,
        "--backend", "torch", "--torch-device", "cpu", "--longest-px", WIDTH_PX // 2,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "backend: torch on cpu" in done.stderr
    assert re.search(
        r"^memory: 0\.\d\d GB .* that are free on device cpu$", done.stderr, re.MULTILINE
    )
    trained = StreamReader(stream).manifest.cameras[0]
    assert (trained.width_px, trained.height_px) == (WIDTH_PX // 2, 18)
    assert verify_stream(stream).num_frames == 2


def test_a_run_logs_every_frame_and_draws_snapshots(capture: Path, tmp_path: Path) -> None:
    stream, points = tmp_path / "stream", tmp_path / "points.npz"
    xyz = np.random.default_rng(0).uniform(-0.5, 0.5, (50, 3))
    np.savez(points, xyz=xyz, rgb=np.full((50, 3), 99, np.uint8))
    train_here(
        capture, stream, "--num-gs", 200, "--swin-size", 2, "--genesis-iterations", 30,
        "--settle-rounds", 1, "--window-iterations", 20, "--segment-frames", 2,
        "--snapshot-every", 2, "--points", points,
    )  # fmt: skip
    records = log_of(stream)
    assert [r["frame"] for r in records] == list(range(FRAMES))
    assert all(r["gaussians"] > 100 for r in records)
    assert all(r["iterations_per_s"] > 0 for r in records)
    assert records[-1]["left_s"] == 0 < records[0]["left_s"]
    assert records[-1]["psnr_db"] > 5
    # Bytes of the complete segments, without keyframes except those of frame 0.
    for frame in (1, 3):
        played = sum(
            file.stat().st_size
            for segment in range(frame // 2 + 1)
            for file in (stream / "segments" / str(segment)).iterdir()
            if segment == 0 or not file.name.startswith("keyframe")
        )
        assert records[frame]["bytes_per_frame"] == round(played / (frame + 1))
    assert any((stream / "segments" / "1").glob("keyframe-*"))
    assert sorted(p.name for p in (stream / "snapshots").iterdir()) == [
        f"{frame:06d}.png" for frame in (0, 2, 4)
    ]
    with Image.open(stream / "snapshots" / "000004.png") as picture:
        captured, rendered, _ = np.array_split(np.asarray(picture), 3, axis=1)
    assert captured.std() > 1
    assert rendered.std() > 1
