"""Parts on a Ray cluster of this machine: real processes, some of which are killed."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

from bench.parts import HOLDER, WORKER, cluster_of, processes
from codec.storage.openfiles import FilesFolder
from codec.tools.audit import verify_stream
from tests.support.commands import command, environment, run, run_ok
from tests.support.parts import FRAMES, SETTINGS, capture_of, contents, do_in_process, run_of, train
from trainer.parts.task import STATE_FOLDER
from trainer.run.outputs import SNAPSHOT_FOLDER
from trainer.run.runlog import LOG_NAME

pytest.importorskip("ray", reason="ray is not installed")

KILLS = 5
TALLY = b"ray::Tally"
"""In the command line of the process that counts what has been done."""


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return capture_of(tmp_path_factory.mktemp("ray"))


@pytest.fixture(scope="module")
def one(capture: Path) -> Path:
    """The stream, by one process after another."""
    stream = capture.parent / "one"
    train(run_of(capture, stream), FilesFolder(stream), do_in_process)
    return stream


@contextmanager
def killer(words: list[bytes], seed: int) -> Iterator[list[int]]:
    """Kills processes of a run at random moments; gives how many it has killed of each kind."""
    killed, done = [0] * len(words), threading.Event()
    rng = random.Random(seed)

    def kill() -> None:
        while not done.wait(rng.uniform(1.0, 3.0)) and sum(killed) < KILLS:
            kind = sum(killed) % len(words)
            for number in rng.sample(found := processes(words[kind]), min(1, len(found))):
                os.kill(number, signal.SIGKILL)
                killed[kind] += 1

    thread = threading.Thread(target=kill)
    thread.start()
    try:
        yield killed
    finally:
        done.set()
        thread.join()


@pytest.mark.slow
def test_a_cluster_with_killed_workers_makes_the_stream_that_one_process_makes(
    capture: Path, one: Path, tmp_path: Path
) -> None:
    with killer([WORKER, HOLDER, TALLY], seed=1) as killed:
        done = run(
            "swings-train", capture, tmp_path / "many", *SETTINGS, "--ray", "--worker-cpus", 1,
            "--snapshot-every", 5,
        )  # fmt: skip
    assert (done.returncode, done.stdout) == (0, f"{tmp_path / 'many'}\n")
    lost = [line for line in done.stderr.splitlines() if line.startswith("a worker died; ")]
    assert lost
    assert "Worker exit type" not in done.stderr  # Ray's own paragraphs
    assert "raylet" not in done.stderr
    assert min(killed) > 0
    assert contents(tmp_path / "many") == contents(one)
    assert not verify_stream(tmp_path / "many").live
    log = (tmp_path / "many" / LOG_NAME).read_text().splitlines()
    assert [json.loads(line)["frame"] for line in log] == [*range(1, FRAMES, 2)]
    pictures = sorted((tmp_path / "many" / SNAPSHOT_FOLDER).iterdir())
    assert [path.name for path in pictures] == [f"{n:06d}.png" for n in range(0, FRAMES, 5)]


@pytest.mark.slow
def test_two_captures_share_a_cluster_of_four_workers(
    capture: Path, one: Path, tmp_path: Path
) -> None:
    streams = [tmp_path / "first", tmp_path / "second"]
    with cluster_of(4) as address, ExitStack() as stack:
        runs = [
            stack.enter_context(
                subprocess.Popen(
                    command(
                        "swings-train", capture, stream, *SETTINGS, "--ray", address,
                        "--worker-cpus", 1,
                    ),
                    env=environment(),
                    stdout=subprocess.DEVNULL,
                    stderr=subprocess.PIPE,
                    text=True,
                )
            )
            for stream in streams
        ]  # fmt: skip
        for run in runs:
            said = run.communicate(timeout=240)[1]
            assert run.returncode == 0, said
    for stream in streams:
        assert contents(stream) == contents(one)


def stop_at(file: str, number: signal.Signals, stream: Path, arguments: list[object]) -> None:
    """Trains until a worker has left `file`, and ends the driver by a signal."""
    driver = subprocess.Popen(
        command("swings-train", *arguments),
        env=environment(),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    deadline_s = time.monotonic() + 120
    while not (stream / STATE_FOLDER / file).exists():
        assert driver.poll() is None
        assert time.monotonic() < deadline_s
        time.sleep(0.01)
    driver.send_signal(number)
    said = driver.communicate()[1]
    if number is signal.SIGKILL:
        assert driver.returncode == -number
    else:
        assert driver.returncode == 128 + number, said
        assert "--resume continues from there" in said


@pytest.mark.slow
def test_a_run_that_is_stopped_goes_on_with_what_is_there(
    capture: Path, one: Path, tmp_path: Path
) -> None:
    stream = tmp_path / "many"
    arguments = [capture, stream, *SETTINGS, "--ray", "--worker-cpus", 1]
    stop_at("genesis.state", signal.SIGTERM, stream, arguments)
    stop_at("part-0.records", signal.SIGINT, stream, [*arguments, "--resume"])
    stop_at("seam-1.records", signal.SIGKILL, stream, [*arguments, "--resume"])
    other = run("swings-train", *arguments, "--resume", "--num-gs", 300)
    assert (other.returncode, other.stderr.count("\n")) == (1, 1)
    assert "needs the options" in other.stderr
    run_ok("swings-train", *arguments, "--resume", "--worker-cpus", 2)  # what changes no byte
    assert contents(stream) == contents(one)


def test_what_no_cluster_can_train_is_one_line(capture: Path, tmp_path: Path) -> None:
    cases: list[tuple[list[object], str]] = [
        (["--swin-size", 5, "--num-gs", 200], "swin_size 1"),
        (["--ray", "127.0.0.1:9"], "127.0.0.1:9"),
        (["--part-frames", 3], "part_frames 3"),
        (["--resume"], "no run with --ray was started there"),
    ]
    for arguments, word in cases:
        given = arguments if "--ray" in arguments else [*arguments, "--ray"]
        done = run("swings-train", capture, tmp_path / "none", *SETTINGS, *given)
        assert done.returncode == 1, done.stderr
        assert done.stderr.count("\n") == 1, done.stderr
        assert word in done.stderr, done.stderr
        assert not (tmp_path / "none").exists()
