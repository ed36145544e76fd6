"""Parts on a Ray cluster of this machine: real processes, some of which are killed."""

from __future__ import annotations

import json
import os
import random
import re
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack, contextmanager
from multiprocessing import get_context
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from bench.parts import WORKER, cluster_of, processes
from codec.errors import InvalidError
from codec.tools.audit import verify_stream
from tests.support.commands import environment, run, run_ok, started
from tests.support.parts import FRAMES, SETTINGS, capture_of, do_here, run_of, train
from tests.support.trainings import contents
from tests.support.waiting import BOUND_S, wait_until
from trainer.parts.raydriver import do_task, task_result
from trainer.parts.task import STATE_FOLDER, Kind, Run, Task
from trainer.run import warm
from trainer.run.config import TrainConfig
from trainer.run.monitor import LOG_NAME
from trainer.run.outputs import SNAPSHOT_FOLDER

pytest.importorskip("ray", reason="ray is not installed")
# Ray starts a dozen processes for each cluster, and gives up if they need more than 30 s.
on_a_cluster = pytest.mark.realtime

CONFIG = TrainConfig("capture", "stream")
KILLS = 5
TALLY = b"ray::Tally"
"""Part of the command line of the process that counts finished work."""


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return capture_of(tmp_path_factory)


@pytest.fixture(scope="module")
def one(capture: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The stream trained by one process, after another one has compiled all kernels."""
    stream = tmp_path_factory.mktemp("ray") / "one"
    run = run_of(capture, stream)
    with ProcessPoolExecutor(1, get_context("spawn"), max_tasks_per_child=1) as pool:
        pool.submit(warm.compile_kernels, run.config.fit.sh_degree).result()
        pool.submit(train, run, do_here).result()
    return stream


@contextmanager
def killer(words: list[bytes], seed: int) -> Iterator[list[int]]:
    """Kills processes of a run at random moments; gives the number of kills of each kind."""
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


@on_a_cluster
def test_killed_workers_make_the_stream_of_one(capture: Path, one: Path, tmp_path: Path) -> None:
    streams, said = [tmp_path / "first", tmp_path / "second"], ""
    with cluster_of(4) as address, killer([WORKER, TALLY], seed=1) as killed, ExitStack() as stack:
        words = (*SETTINGS, "--ray", address, "--worker-cpus", 1, "--snapshot-every", 5)
        runs = [
            stack.enter_context(started("swings-train", capture, stream, *words))
            for stream in streams
        ]
        for driver in runs:
            said += driver.communicate()[1]
            assert driver.returncode == 0, said
    assert min(killed) > 0
    assert re.search(r"^worker process \d+ on node [\d.]+ was killed", said, re.MULTILINE)
    assert "Worker exit type" not in said  # Ray's own paragraphs
    assert "raylet" not in said
    for stream in streams:
        assert contents(stream) == contents(one)
        assert not verify_stream(stream).live
        log = (stream / LOG_NAME).read_text().splitlines()
        assert [json.loads(line)["frame"] for line in log] == [*range(1, FRAMES, 2)]
        pictures = sorted((stream / SNAPSHOT_FOLDER).iterdir())
        assert [path.name for path in pictures] == [f"{n:06d}.png" for n in range(0, FRAMES, 5)]


def stop_at(file: str, number: signal.Signals, stream: Path, arguments: list[object]) -> None:
    """Trains until a worker has written `file`, then ends the driver by a signal."""
    driver = started("swings-train", *arguments)
    left = stream / STATE_FOLDER / file
    wait_until(lambda: left.exists() or driver.poll() is not None)
    assert left.exists(), driver.communicate()[1]
    driver.send_signal(number)
    said = driver.communicate()[1]
    if number is signal.SIGKILL:
        assert driver.returncode == -number
    else:
        assert driver.returncode == 128 + number, said
        assert "--resume continues from there" in said


@on_a_cluster
def test_a_stopped_run_goes_on_with_what_is_there(capture: Path, one: Path, tmp_path: Path) -> None:
    stream = tmp_path / "many"
    arguments = [capture, stream, *SETTINGS, "--ray", "--worker-cpus", 1]
    stop_at("genesis.state", signal.SIGTERM, stream, arguments)
    stop_at("part-0.records", signal.SIGINT, stream, [*arguments, "--resume"])
    stop_at("part-1.records", signal.SIGKILL, stream, [*arguments, "--resume"])
    other = run("swings-train", *arguments, "--resume", "--num-gs", 300)
    assert (other.returncode, other.stderr.count("\n")) == (1, 1)
    assert "needs the options" in other.stderr
    words = [*arguments, "--resume", "--worker-cpus", 2]  # options that change no byte
    assert run_ok("swings-train", *words) == f"{stream}\n"
    assert contents(stream) == contents(one)


@on_a_cluster
def test_a_cluster_of_this_machine_alone_is_a_new_one_that_others_cannot_use() -> None:
    code = """
import os, subprocess, sys
from rich.console import Console
from trainer.parts.raydriver import open_cluster

others = dict(os.environ)
with open_cluster("local", 1, Console()) as ray:
    address = ray.get_runtime_context().gcs_address
    ask = f"from ray._raylet import GcsClient; GcsClient({address!r}).get_all_node_info(timeout=9)"
    for environment in (os.environ, others, {**os.environ, "RAY_AUTH_TOKEN": 64 * "0"}):
        done = subprocess.run([sys.executable, "-c", ask], env=environment, capture_output=True)
        print(done.returncode, b"token" in done.stderr, file=sys.stderr)
"""
    argv = [sys.executable, "-c", code]
    elsewhere = {**environment(), "RAY_ADDRESS": "127.0.0.1:1"}  # there is no cluster
    done = subprocess.run(argv, env=elsewhere, capture_output=True, text=True, timeout=BOUND_S)
    assert done.stderr.splitlines() == ["0 False", "1 True", "1 True"]


def test_a_process_that_compiles_kernels_leaves_its_task_undone(
    capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import ray

    here = SimpleNamespace(get_node_id=lambda: "here")
    monkeypatch.setattr(ray, "get_runtime_context", lambda: here)
    monkeypatch.setattr(warm, "compile_kernels", lambda sh_degree: True)
    reported = list[tuple[str, int]]()
    tally = SimpleNamespace(report=SimpleNamespace(remote=lambda *told: reported.append(told)))
    task = Task(run_of(capture, tmp_path), Kind.GENESIS)
    assert do_task(task, tally, frozenset({"elsewhere"})) == "here"
    assert not reported
    # If numba cannot cache compiled code, the second process still does the task.
    assert do_task(task, tally, frozenset({"here"})) is None
    assert reported[-1] == ("genesis", task.iterations)
    assert do_task(task, tally, frozenset()) is None  # it is done
    assert (tmp_path / task.last_path).exists()


def test_what_ray_gives_up_on_is_one_line() -> None:
    import ray as real

    exceptions: Any = real.exceptions

    def get(error: Exception) -> None:
        raise error

    ray, task = SimpleNamespace(get=get, exceptions=exceptions), Task(Run(CONFIG, ()), Kind.GENESIS)
    full = exceptions.RayTaskError("do_task", "Traceback\n...", OSError("disc is full\nat 7"))
    for error, line in [
        (exceptions.WorkerCrashedError(), "genesis: The worker died .*31 times"),
        (exceptions.OutOfMemoryError("no memory is left\nand more"), "genesis: no memory is left"),
        (full.as_instanceof_cause(), "genesis: OSError: disc is full, 31 times$"),
    ]:
        with pytest.raises(InvalidError, match=line) as found:
            task_result(ray, error, task)
        assert "\n" not in str(found.value)


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (("--ray", "--swin-size", 5), "--swin-size 1"),
        (("--ray", "--whole-slices"), "--no-whole-slices"),
        (("--ray", "--part-frames", 3), "part_frames 3"),
        pytest.param(("--ray", "127.0.0.1:9"), "127.0.0.1:9", marks=on_a_cluster),
        pytest.param(("--ray", "--resume"), "no run with --ray was started", marks=on_a_cluster),
    ],
)
def test_what_no_cluster_can_train_is_one_line(
    arguments: tuple[object, ...], word: str, capture: Path, tmp_path: Path
) -> None:
    done = run("swings-train", capture, tmp_path / "none", *SETTINGS, *arguments)
    assert (done.returncode, done.stderr.count("\n")) == (1, 1), done.stderr
    assert word in done.stderr
    assert not (tmp_path / "none").exists()
