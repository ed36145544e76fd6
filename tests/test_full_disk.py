"""Every command that writes a file reports in one line which one had no room, and leaves no partial
file.

A limit on the size of files replaces the full disk: it stops the same calls at the same places.
"""

from __future__ import annotations

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from codec.stream import StreamReader
from codec.stream.poster import POSTER_NAME
from codec.tools.audit import verify_stream
from tests.support.commands import run, run_ok
from tests.support.hostile import file_limit
from tests.support.tiny_capture import seen_by, write_dynamic3dgs
from tests.support.tiny_stream import tiny_manifest, write_tiny
from trainer.run.monitor import RunLog

FRAMES = 6
TRAINING = (
    "swings-train", "capture", "trained", "--num-gs", 400, "--genesis-iterations", 8,
    "--settle-rounds", 1, "--window-iterations", 4, "--segment-frames", 2, "--snapshot-every", 1,
)  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a capture, a stream of it, and a file of Gaussians."""
    root = tmp_path_factory.mktemp("full")
    write_dynamic3dgs(root / "capture", num_cameras=4, num_frames=FRAMES)
    manifest = replace(seen_by(tiny_manifest(), root / "capture"), poster=POSTER_NAME)
    write_tiny(root / "stream", FRAMES, manifest)
    run_ok("swings-stream", "export", "stream", "frame.ply", "--frame", 0, folder=root)
    return root


def files(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}


COMMANDS: dict[str, tuple[int, str, tuple[object, ...]]] = {
    "static export": (
        300, "out/segments", ("swings-stream", "export", "stream", "out", "--static"),
    ),
    "ply": (300, "out.ply", ("swings-stream", "export", "stream", "out.ply", "--frame", 0)),
    "numbered": (
        300, "out_0000.spz", ("swings-stream", "export", "stream", "out.spz", "--frames", ":"),
    ),
    "plot": (300, "out.png", ("swings-stream", "info", "stream", "--plot", "out.png")),
    "check": (300, "out.png", ("swings-train", "capture", "--check", "out.png")),
    "sheet": (300, "out.png", ("swings-eval", "stream", "capture", "--sheet", "out.png")),
    "compared video": (
        300, "out.mp4", ("swings-eval", "stream", "capture", "--compare", "cam01", "out.mp4"),
    ),
    "pictures": (300, "out/frame_00000.png", ("swings-play", "stream", "--capture", "out")),
    "turntable": (
        300, "out.mp4",
        ("swings-play", "stream", "--still", 0, "--capture", "out.mp4", "--turntable", 1),
    ),
    "still": (300, "out.png", ("swings-play", "stream", "--still", 0, "--capture", "out.png")),
    "video of a capture": (
        900, "out/cam0", ("swings-synth", "out", "--frames", 2, "--cameras", 3, "--held-out", 1,
                     "--width-px", 64, "--height-px", 36),
    ),
    "poses and points of a capture": (
        20_000, "out", ("swings-synth", "out", "--frames", 1, "--cameras", 3, "--held-out", 1,
                        "--width-px", 32, "--height-px", 32, "--points", 4000),
    ),
}  # fmt: skip
"""Bytes that fit, the file that the line names, and the command; all of them write to out*."""


@pytest.mark.parametrize("what", COMMANDS)
def test_a_full_disk_is_one_line_with_the_file_and_leaves_nothing(what: str, folder: Path) -> None:
    limit_bytes, place, (name, *arguments) = COMMANDS[what]
    before = files(folder)
    done = run(str(name), *arguments, folder=folder, limits={"FSIZE": limit_bytes})
    assert done.returncode == 1, done.stderr
    *_, line = done.stderr.strip().splitlines()  # after the progress
    assert line.startswith(f"{name}: ")
    assert place in line, line
    assert line.endswith(" cannot be written: File too large")
    assert files(folder) == before


def test_an_import_without_room_names_the_file(folder: Path) -> None:
    words = ("swings-stream", "import", "frame.ply", "out")
    done = run(*words, folder=folder, limits={"FSIZE": 100})
    assert done.returncode == 1
    (line,) = done.stderr.strip().splitlines()
    assert line == "swings-stream: out/manifest.json cannot be written: File too large"
    assert not [name for name in files(folder) if name.endswith((".tmp", ".partial"))]
    shutil.rmtree(folder / "out", ignore_errors=True)


def test_training_without_room_is_told_and_goes_on_later(folder: Path) -> None:
    """At each limit another file is the first that is too long. For each of them, the run can be
    resumed, and the stream is complete at the end."""
    named = set[str]()
    for limit_bytes in (4_000, 90_000):
        resume = ["--resume"] if (folder / "trained").exists() else []
        done = run(*TRAINING, *resume, folder=folder, limits={"FSIZE": limit_bytes})
        if done.returncode == 0:
            break
        line = done.stderr.strip().splitlines()[-1]
        found = re.fullmatch(r"swings-train: (trained/\S+) cannot be written: File too large", line)
        assert found, line
        named.add(found[1])
        assert not list((folder / "trained").rglob("*.tmp"))
        reader = StreamReader(folder / "trained")
        for frame in range(reader.num_frames):
            reader.active_splats(frame, reader.manifest.num_layers)
    else:
        run_ok(*TRAINING, "--resume", folder=folder)
    assert "trained/.checkpoint.npz" in named
    assert verify_stream(folder / "trained").num_frames == FRAMES
    shutil.rmtree(folder / "trained")


def test_a_log_keeps_whole_lines_only(tmp_path: Path) -> None:
    path = tmp_path / "training.jsonl"
    records = [{"frame": frame, "text": "y" * 40} for frame in range(3)]
    with RunLog(path) as log:
        log.add(records[0])
        with file_limit(90), pytest.raises(OSError, match=r"training\.jsonl"):
            log.add(records[1])
        assert path.read_text().count("\n") == 1
        log.add(records[1])
    whole = path.read_bytes()
    path.write_bytes(whole + b'{"frame": 2, "te')  # the machine stopped
    with RunLog(path) as log:
        log.add(records[2])
    assert [json.loads(line) for line in path.read_text().splitlines()] == records
