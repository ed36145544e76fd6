"""A run that is killed and resumed writes the same bytes as an uninterrupted one."""

from __future__ import annotations

import errno
import shutil
import signal
import subprocess
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from codec.errors import InvalidError, SwingsError
from codec.slots.slotlayout import Update
from codec.stream import StreamReader
from codec.stream.manifest import MANIFEST_NAME
from codec.stream.poster import POSTER_NAME
from tests.support.commands import command, environment, run, run_ok
from tests.support.hostile import refused
from tests.support.slots.updates import patternless_updates, small_layout
from tests.support.suite.once import made_once
from tests.support.tiny_stream import tiny_slice
from tests.support.trainings import contents, run_until, train_here
from trainer.errors import CheckpointError
from trainer.fit.observer import Observer
from trainer.run import job
from trainer.run.checkpoint import CHECKPOINT_NAME, arrays_of, load_checkpoint, save_checkpoint

FRAMES = 6
COMMON = (
    "--num-gs", 100, "--genesis-iterations", 40, "--settle-rounds", 1, "--window-iterations", 20,
    "--segment-frames", 4, "--mcmc.relocate-period", 10,
)  # fmt: skip
SETTINGS_OF = {
    "two frames": (*COMMON, "--swin-size", 2),
    "one frame": COMMON,
    "budget": (*COMMON, "--lease.bytes-per-frame", 300, "--lease.active-share", 0.9),
    "whole slices": (*COMMON, "--swin-size", 2, "--whole-slices"),
}
"""Each kind of run: with leases of two frames, of one, with a byte budget (its balance must
survive), and with slices sent whole."""
SETTINGS = SETTINGS_OF["two frames"]


def moments_of(capture: Path, kind: str, factory: pytest.TempPathFactory) -> Path:
    """A folder with a stream, `whole`, and with what a kill would have left while it was trained:
    `N old` before the checkpoint number N is written, when what it is about is in the stream
    already, and `N new` after it. Number 0 is at the start, 1 to 3 are in genesis, after each 20
    iterations, and the others after each frame."""

    def make(folder: Path) -> None:
        stream, count = folder / "whole", iter(range(99))

        def save(path: Path, *given: Any) -> None:
            number = next(count)
            shutil.copytree(stream, folder / f"{number} old")
            save_checkpoint(path, *given)
            shutil.copytree(stream, folder / f"{number} new")

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(job, "KEEP_S", 0.0)
            patch.setattr(job, "save_checkpoint", save)
            train_here(capture, stream, *SETTINGS_OF[kind])
        assert next(count) == 4 + FRAMES

    return made_once(factory, f"resume {kind}", make)


@pytest.fixture
def moments(capture: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return moments_of(capture, "two frames", tmp_path_factory)


class Begun(Observer):
    """Records the windows of a run with their finished iterations, and the stream's posters."""

    def __init__(self, stream: Path) -> None:
        self.stream, self.windows = stream, list[tuple[int, int]]()
        self.posters = list[bytes]()

    def window_begun(self, first_frame: int, done: int) -> None:
        self.windows.append((first_frame, done))
        if (self.stream / POSTER_NAME).exists():
            self.posters.append((self.stream / POSTER_NAME).read_bytes())


def goes_on_at(number: int, is_old: bool) -> tuple[int, int]:
    """The window, and its finished iterations, of the last checkpoint at a moment."""
    kept = number - is_old
    return (0, 20 * kept) if kept < 4 else (kept - 3, 0)


QUICK = {
    ("two frames", 6, True), ("two frames", 8, False), ("one frame", 2, False),
    ("budget", 7, True), ("whole slices", 2, False), ("whole slices", 8, True),
}  # fmt: skip


@pytest.mark.parametrize(
    ("kind", "number", "is_old"),
    [
        pytest.param(*case, marks=() if case in QUICK else pytest.mark.deep)
        for kind in SETTINGS_OF
        for number in range(4 + FRAMES)
        for is_old in (True, False)
        if (case := (kind, number, is_old)) != (kind, 0, True)
    ],
)
def test_killed_at_any_moment_it_goes_on_and_writes_the_same_bytes(
    kind: str,
    number: int,
    is_old: bool,
    capture: Path,
    tmp_path: Path,
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    moments, stream = moments_of(capture, kind, tmp_path_factory), tmp_path / "stream"
    shutil.copytree(moments / f"{number} {'old' if is_old else 'new'}", stream)
    had_manifest = (stream / MANIFEST_NAME).exists()
    assert had_manifest or kind == "whole slices"  # they start a stream after genesis
    poster = b""
    if had_manifest:
        reader = StreamReader(stream)  # valid at every instant
        for frame in range(reader.num_frames):
            reader.active_splats(frame, reader.manifest.num_layers)
        assert (stream / POSTER_NAME).exists() == (reader.num_frames > 0)
        poster = (stream / POSTER_NAME).read_bytes() if reader.num_frames else b""
    begun = Begun(stream)
    train_here(capture, stream, "--resume", observers=[begun])
    wanted = goes_on_at(number, is_old)
    left = [wanted, *((n, 0) for n in range(wanted[0] + 1, FRAMES))]
    assert begun.windows == (left if wanted[0] < FRAMES else [])
    assert not poster or set(begun.posters) <= {poster}
    assert contents(stream) == contents(moments / "whole")


@pytest.mark.parametrize(
    ("number", "says"),
    [
        (signal.SIGKILL, None),
        (signal.SIGINT, "stopped after frame 3; --resume continues from there"),
        (signal.SIGTERM, "stopped after frame 2; --resume continues from there"),
    ],
)
def test_a_process_that_a_signal_ends_is_resumed_by_the_command(
    number: signal.Signals, says: str | None, capture: Path, moments: Path, tmp_path: Path
) -> None:
    stream = tmp_path / "stream"
    done = run_until(number, 3, capture, stream, *SETTINGS)
    assert done.returncode == (128 + number if says else -number), done.stderr
    assert says is None or done.stderr.splitlines()[-1] == says
    # No option has to be repeated: the first run's settings are stored.
    assert run_ok("swings-train", capture, stream, "--resume") == f"{stream}\n"
    assert contents(stream) == contents(moments / "whole")


def test_a_finished_run_resumes_with_success(capture: Path, moments: Path, tmp_path: Path) -> None:
    stream = tmp_path / "stream"
    shutil.copytree(moments / "whole", stream)
    for more in ([], ["--ray"], SETTINGS):
        again = run("swings-train", capture, stream, "--resume", *more)
        assert (again.returncode, again.stdout) == (0, f"{stream}\n")
        assert again.stderr == f"{stream} is finished, {FRAMES} frames; nothing is left to train\n"
    # Killed after its last frame, before its last poster was drawn and its checkpoint removed.
    (stream / CHECKPOINT_NAME).write_bytes(b"of the last window")
    (stream / POSTER_NAME).write_bytes(b"of the first segment")
    train_here(capture, stream, "--resume")
    assert contents(stream) == contents(moments / "whole")


def test_resuming_something_else_is_refused(capture: Path, moments: Path, tmp_path: Path) -> None:
    def refusal(*words: object) -> str:
        return str(refused(SwingsError, "", train_here, *words))

    stream, take = tmp_path / "stream", tmp_path / "take"
    assert "nothing to resume" in refusal(capture, stream, *SETTINGS, "--resume")
    shutil.copytree(moments / "5 new", stream)
    before = contents(stream)
    other = run(
        "swings-train", capture, stream, "--resume", "--seed", 5, "--lease.hold", 0.5,
        "--preset", "fast", "--num-gs", 100,
    )  # fmt: skip
    assert other.returncode == 1
    (line,) = other.stderr.splitlines()
    assert "lease.hold was" in line
    assert "preset was 'cpu' and is 'fast' now" in line
    assert "seed was 0 and is 5 now" in line
    assert "num_gs" not in line  # given, with the same value
    # The same rig and number of frames, another take.
    shutil.copytree(capture, take)
    videos = sorted(take.glob("*.mp4"))
    for video, later in pairwise(videos):
        shutil.copyfile(later, video)
    assert "first_picture" in refusal(take, stream, "--resume")
    assert "--resume" in refusal(capture, stream, *SETTINGS)
    assert contents(stream) == before


def test_a_run_that_had_no_room_for_its_first_checkpoint_begins_anew(
    capture: Path, moments: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(path: Path, *given: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device", str(path))

    stream = tmp_path / "stream"
    with monkeypatch.context() as patch:
        patch.setattr(job, "save_checkpoint", full)
        refused(OSError, CHECKPOINT_NAME, train_here, capture, stream, *SETTINGS)
    names = [".settings.json", "index.bin", "manifest.json", "segments"]
    assert sorted(p.name for p in stream.iterdir()) == names
    train_here(capture, stream, "--resume")
    assert contents(stream) == contents(moments / "whole")


def test_a_damaged_checkpoint_is_told(tmp_path: Path) -> None:
    path = tmp_path / CHECKPOINT_NAME
    state = {"values0": np.arange(6, dtype=np.float32)}
    save_checkpoint(path, state, [], {"seed": 1})
    found = load_checkpoint(path, {"seed": 1})
    assert (found.state["values0"] == state["values0"]).all()
    assert found.pending == []
    refused(InvalidError, "seed", load_checkpoint, path, {"seed": 2})
    data = path.read_bytes()
    for size in range(0, len(data), 37):
        path.write_bytes(data[:size])
        refused(CheckpointError, "", load_checkpoint, path, {"seed": 1})


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
    for part, before in zip(found, [*slices, *updates], strict=True):
        assert type(part) is type(before)
        assert part.birth == before.birth
        arrays = arrays_of(before)
        assert len(arrays) == (10 if isinstance(before, Update) else 6)
        for name, array in arrays_of(part).items():
            assert array.dtype == arrays[name].dtype
            assert np.array_equal(array, arrays[name])


@pytest.mark.deep
def test_compiling_runs_write_the_same_bytes(capture: Path, moments: Path, tmp_path: Path) -> None:
    stream = tmp_path / "stream"
    done = subprocess.run(
        command("swings-train", capture, stream, *SETTINGS),
        env={**environment(), "NUMBA_CACHE_DIR": str(tmp_path / "cache")},
        capture_output=True,
        text=True,
        timeout=800,
    )
    assert done.returncode == 0, done.stderr
    assert any((tmp_path / "cache").rglob("*.nbc"))
    assert done.stderr.count("compiling kernels (half a minute, once)\n") == 1
    assert contents(stream) == contents(moments / "whole")
