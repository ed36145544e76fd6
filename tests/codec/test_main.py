"""swings-stream as a process: its output and exit codes."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.support.commands import run, run_ok
from tests.support.tiny_stream import write_tiny


@pytest.fixture(scope="module")
def stream(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("main") / "stream"
    write_tiny(path, 6)
    return path


def test_info_tells_the_same_to_people_and_programs(stream: Path) -> None:
    told = json.loads(run_ok("swings-stream", "info", stream, "--json"))
    assert (told["num_frames"], told["swin_size"], told["num_gs"]) == (6, 3, 120)
    # A player from frame 0 on fetches all objects but the snapshots of later segments.
    objects = [*stream.glob("segments/0/*"), *stream.glob("segments/1/[!s]*")]
    objects_bytes = sum(path.stat().st_size for path in objects)
    assert told["layers"][-1]["size_bytes"] == objects_bytes
    assert told["size_bytes"] == sum(p.stat().st_size for p in stream.rglob("*") if p.is_file())
    assert told["bytes_per_gaussian"] == pytest.approx(objects_bytes / (8 * 40))
    assert told["layers"][0]["gaussians_share"] == 0.5
    text = run_ok("swings-stream", "info", stream)
    assert "6 frames, 0.2 s at 25 fps" in text
    assert f"{told['played_bytes']} bytes" in text


def test_verify_exits_with_0_and_with_1_and_bad_usage_with_2(stream: Path, tmp_path: Path) -> None:
    assert "6 frames in 2 segments are intact" in run_ok("swings-stream", "verify", stream)
    done = run("swings-stream", "verify", tmp_path)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (1, "", 1)
    assert done.stderr.startswith("swings-stream: ")
    assert "manifest.json" in done.stderr
    assert run("swings-stream", "polish").returncode == 2


def test_the_help_of_export_names_its_first_file(stream: Path, tmp_path: Path) -> None:
    run_ok("swings-stream", "export", stream, tmp_path / "name.ply", "--frames", "0:2")
    first = min(path.name for path in tmp_path.iterdir())
    assert f"gives {first}" in " ".join(run_ok("swings-stream", "export", "--help").split())
