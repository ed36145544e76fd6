"""A run that is killed and resumed writes the same bytes as an uninterrupted one."""

from __future__ import annotations

import io
import re
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from rich.console import Console

from codec.errors import InvalidError
from codec.slice import Slice
from codec.slots.update import Update
from codec.stream import StreamReader
from codec.stream.manifest import MANIFEST_NAME
from codec.stream.poster import POSTER_NAME
from tests.support.commands import command, environment, run, run_ok, started
from tests.support.slots.updates import patternless_updates, small_layout
from tests.support.tiny_capture import write_dynerf
from tests.support.tiny_stream import tiny_slice
from trainer.errors import CheckpointError
from trainer.fit.observer import Observer
from trainer.run.checkpoint import CHECKPOINT_NAME, load_checkpoint, save_checkpoint
from trainer.run.config import TrainConfig
from trainer.run.job import train_stream
from trainer.run.preset import parse_with_preset
from trainer.run.runlog import LOG_NAME

FRAMES = 6
COMMON = (
    "--num-gs", 200, "--genesis-iterations", 60, "--settle-rounds", 1, "--window-iterations", 40,
    "--segment-frames", 4, "--mcmc.relocate-period", 10,
)  # fmt: skip
SETTINGS = (*COMMON, "--swin-size", 2)
SETTINGS_OF = {
    "two frames": SETTINGS,
    "one frame": COMMON,
    "budget": (*COMMON, "--lease.bytes-per-frame", 300, "--lease.active-share", 0.9),
    "whole slices": (*SETTINGS, "--whole-slices"),
}
"""Each kind of run: with leases of two frames, of one, with a byte budget (its balance must
survive), and with slices sent whole."""


@dataclass(frozen=True)
class Whole:
    """An uninterrupted run."""

    settings: tuple[object, ...]
    contents: dict[str, bytes]


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("resume") / "capture"
    write_dynerf(path, 4, FRAMES)
    return path


def contents(stream: Path) -> dict[str, bytes]:
    """Every file except the log, which contains times."""
    return {
        str(f.relative_to(stream)): f.read_bytes()
        for f in sorted(stream.rglob("*"))
        if f.is_file() and f.name != LOG_NAME
    }


def trained_whole(capture: Path, kind: str) -> Whole:
    stream = capture.parent / f"whole {kind}"
    if not stream.exists():
        run_ok("swings-train", capture, stream, *SETTINGS_OF[kind])
    assert not (stream / CHECKPOINT_NAME).exists()
    return Whole(SETTINGS_OF[kind], contents(stream))


@pytest.fixture(scope="module", params=SETTINGS_OF)
def whole(request: pytest.FixtureRequest, capture: Path) -> Whole:
    return trained_whole(capture, request.param)


@pytest.fixture(scope="module")
def uninterrupted(capture: Path) -> dict[str, bytes]:
    return trained_whole(capture, "two frames").contents


def start_until(
    capture: Path,
    stream: Path,
    windows: int,
    *more: object,
    settings: tuple[object, ...] = SETTINGS,
) -> subprocess.Popen[str]:
    """A training process that has written `windows` checkpoints after its first one."""
    process = started("swings-train", capture, stream, *settings, *more)
    kept, seen, last = stream / CHECKPOINT_NAME, -1, 0
    before = kept.stat().st_mtime_ns if kept.exists() else 0
    deadline = time.monotonic() + 200
    while seen < windows and process.poll() is None:
        assert time.monotonic() < deadline
        now = kept.stat().st_mtime_ns if kept.exists() else 0
        if now not in (before, last):
            seen, last = seen + 1, now
        time.sleep(0.001)
    return process


def test_killed_at_any_moment_and_resumed_it_writes_the_same_bytes(
    capture: Path, whole: Whole, tmp_path: Path
) -> None:
    stream = tmp_path / "stream"
    kills = 0
    for windows in (0, 2, 1):
        resume = ["--resume"] if kills else []
        process = start_until(capture, stream, windows, *resume, settings=whole.settings)
        if process.poll() is None:
            process.kill()
            kills += 1
        process.communicate()
        if not (stream / MANIFEST_NAME).exists():  # whole slices start a stream after genesis
            assert "--whole-slices" in whole.settings
            continue
        reader = StreamReader(stream)  # valid at every instant
        for frame in range(reader.num_frames):
            reader.active_splats(frame, reader.manifest.num_layers)
    assert kills >= 2
    if (stream / CHECKPOINT_NAME).exists():
        run_ok("swings-train", capture, stream, *whole.settings, "--resume")
    assert contents(stream) == whole.contents


class Begun(Observer):
    """Records the window with which a run continues, and its finished iterations."""

    def __init__(self) -> None:
        self.windows: list[tuple[int, int]] = []

    def window_begun(self, first_frame: int, done: int) -> None:
        self.windows.append((first_frame, done))


@pytest.mark.parametrize("kind", ["one frame", "whole slices"])
def test_killed_in_genesis_it_goes_on_there(capture: Path, kind: str, tmp_path: Path) -> None:
    whole, stream, begun = trained_whole(capture, kind), tmp_path / "stream", Begun()
    code = """
import os, signal, sys
from trainer.__main__ import train
from trainer.run import job

class Killing(job.Monitor):
    def progressed(self, progress):
        if progress.iteration == 80:
            os.kill(os.getpid(), signal.SIGKILL)

job.KEEP_S, job.Monitor = 0.0, Killing
sys.exit(train())
"""
    argv = [sys.executable, "-c", code, *map(str, (capture, stream, *whole.settings))]
    done = subprocess.run(argv, env=environment(), capture_output=True, text=True, timeout=200)
    assert done.returncode == -signal.SIGKILL, done.stderr
    # The settings of the killed run are read from its checkpoint.
    config = parse_with_preset(TrainConfig, [str(capture), str(stream), "--resume"])
    train_stream(config, Console(file=io.StringIO()), observers=[begun])
    assert begun.windows[:2] == [(0, 60), (1, 0)]
    assert contents(stream) == whole.contents


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_ends_the_run_and_it_can_be_resumed(
    number: signal.Signals, capture: Path, uninterrupted: dict[str, bytes], tmp_path: Path
) -> None:
    stream = tmp_path / "stream"
    process = start_until(capture, stream, 1)
    process.send_signal(number)
    _, errors = process.communicate(timeout=60)
    if process.returncode == 0:
        pytest.skip("the run was over before the signal came")
    assert process.returncode == 128 + number
    last = errors.splitlines()[-1]
    # A signal may arrive when the checkpoint is on disk and its frame not yet counted.
    when = r"(after frame \d+|before the first frame was finished)"
    assert re.fullmatch(rf"stopped {when}; --resume continues from there", last)
    run_ok("swings-train", capture, stream, *SETTINGS, "--resume")
    assert contents(stream) == uninterrupted


def test_a_finished_run_has_nothing_to_resume_and_succeeds(
    capture: Path, uninterrupted: dict[str, bytes], tmp_path: Path
) -> None:
    stream = tmp_path / "stream"
    shutil.copytree(capture.parent / "whole two frames", stream)
    for more in ([], ["--ray"], SETTINGS):
        again = run("swings-train", capture, stream, "--resume", *more)
        assert (again.returncode, again.stdout) == (0, f"{stream}\n")
        assert again.stderr == f"{stream} is finished, {FRAMES} frames; nothing is left to train\n"
    # Killed after its last frame, before its last poster was drawn and its checkpoint removed.
    (stream / CHECKPOINT_NAME).write_bytes(b"of the last window")
    (stream / POSTER_NAME).write_bytes(b"of the first segment")
    run_ok("swings-train", capture, stream, "--resume")
    assert contents(stream) == uninterrupted


def test_a_poster_comes_with_the_first_segment_and_stays_when_the_run_goes_on(
    capture: Path, uninterrupted: dict[str, bytes], tmp_path: Path
) -> None:
    stream = tmp_path / "stream"
    process = start_until(capture, stream, 4)
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=60)
    if process.returncode == 0:
        pytest.skip("the run was over before the signal came")
    assert StreamReader(stream).num_frames == 4
    first = (stream / POSTER_NAME).read_bytes()
    process = start_until(capture, stream, 0, "--resume")
    assert (stream / POSTER_NAME).read_bytes() in (first, uninterrupted[POSTER_NAME])
    process.communicate(timeout=60)
    assert contents(stream) == uninterrupted


def test_resuming_what_is_not_there_or_other_is_one_line(
    capture: Path, uninterrupted: dict[str, bytes], tmp_path: Path
) -> None:
    stream = tmp_path / "stream"
    nothing = run("swings-train", capture, stream, *SETTINGS, "--resume")
    assert nothing.returncode == 1
    assert "nothing to resume" in nothing.stderr
    process = start_until(capture, stream, 0)
    process.kill()
    process.communicate()
    other = run(
        "swings-train", capture, stream, "--resume", "--seed", 5, "--lease.hold", 0.5,
        "--preset", "fast", "--num-gs", 200,
    )  # fmt: skip
    assert other.returncode == 1
    (line,) = other.stderr.splitlines()
    assert "lease.hold was" in line
    assert "preset was 'cpu' and is 'fast' now" in line
    assert "seed was 0 and is 5 now" in line
    assert "num_gs" not in line  # given, with the same value
    # The same rig and number of frames, another take.
    take = tmp_path / "take"
    shutil.copytree(capture, take)
    videos = sorted(take.glob("*.mp4"))
    shutil.copyfile(videos[1], videos[0])
    shutil.copyfile(videos[2], videos[1])
    shutil.copyfile(videos[3], videos[2])
    another = run("swings-train", take, stream, "--resume")
    assert another.returncode == 1
    assert "first_picture" in another.stderr
    again = run("swings-train", capture, stream, *SETTINGS)
    assert again.returncode == 1
    assert "--resume" in again.stderr
    # No option has to be repeated: the first run's settings are stored.
    run_ok("swings-train", capture, stream, "--resume")
    assert contents(stream) == uninterrupted


def test_a_run_that_had_no_room_for_its_first_checkpoint_begins_anew(
    capture: Path, uninterrupted: dict[str, bytes], tmp_path: Path
) -> None:
    stream = tmp_path / "stream"
    full = subprocess.run(
        ["sh", "-c", 'ulimit -f 8; exec "$@"', "sh",
         *command("swings-train", capture, stream, *SETTINGS)],
        env=environment(),
        capture_output=True,
        text=True,
        timeout=120,
    )  # fmt: skip
    assert full.returncode == 1
    line = full.stderr.splitlines()[-1]
    assert str(stream / CHECKPOINT_NAME) in line
    assert sorted(p.name for p in stream.iterdir()) == ["index.bin", "manifest.json", "segments"]
    run_ok("swings-train", capture, stream, *SETTINGS, "--resume")
    assert contents(stream) == uninterrupted


def test_a_damaged_checkpoint_is_told(tmp_path: Path) -> None:
    path = tmp_path / CHECKPOINT_NAME
    state = {"values0": np.arange(6, dtype=np.float32)}
    save_checkpoint(path, state, [], {"seed": 1})
    found = load_checkpoint(path, {"seed": 1})
    assert (found.state["values0"] == state["values0"]).all()
    assert found.pending == []
    with pytest.raises(InvalidError, match="seed"):
        load_checkpoint(path, {"seed": 2})
    data = path.read_bytes()
    for size in range(0, len(data), 37):
        path.write_bytes(data[:size])
        with pytest.raises(CheckpointError):
            load_checkpoint(path, {"seed": 1})


@pytest.mark.parametrize("sh_degree", [0, 1])
def test_updates_come_back_from_a_checkpoint(sh_degree: int, tmp_path: Path) -> None:
    path = tmp_path / CHECKPOINT_NAME
    layout = small_layout(2, (9, 6), sh_degree, 4)
    updates = patternless_updates(layout, 5, wild=True)
    assert any(len(update.escapes) for update in updates)
    updates.append(Update.keeping(5, layout))  # zeros only
    slices = [tiny_slice(birth) for birth in (-1, 0)]
    save_checkpoint(path, {}, [*slices, *updates], {})
    found = load_checkpoint(path, {}).pending
    assert [part.birth for part in found] == [-1, 0, *(update.birth for update in updates)]
    for part, before in zip(found, [*slices, *updates], strict=True):
        assert type(part) is type(before)
        for mine, theirs in zip(arrays_of(part), arrays_of(before), strict=True):
            assert mine.dtype == theirs.dtype
            assert np.array_equal(mine, theirs)


def arrays_of(part: Slice | Update) -> list[npt.NDArray[Any]]:
    """All its arrays."""
    if isinstance(part, Slice):
        return [*part.splats.arrays, part.start_offsets]
    return [
        part.statuses, part.states.positions, part.states.attributes, part.start_offsets,
        part.escaped, *part.escapes.arrays,
    ]  # fmt: skip


@pytest.mark.slow
def test_the_run_that_compiles_the_kernels_writes_the_same_bytes(
    capture: Path, uninterrupted: dict[str, bytes], tmp_path: Path
) -> None:
    stream = tmp_path / "stream"
    done = subprocess.run(
        command("swings-train", capture, stream, *SETTINGS),
        env={**environment(), "NUMBA_CACHE_DIR": str(tmp_path / "cache")},
        capture_output=True,
        text=True,
        timeout=280,
    )
    assert done.returncode == 0, done.stderr
    assert any((tmp_path / "cache").rglob("*.nbc"))
    assert done.stderr.count("compiling kernels (half a minute, once)\n") == 1
    assert contents(stream) == uninterrupted
