"""`swings-train --ray`: a run in parts on a Ray cluster, from the driver's side.

Ray decides where each task is done, and has it done again where its worker died. What is done runs
in a process of its own, so that it compiles and threads as a run without Ray does.
"""

from __future__ import annotations

import logging
import math
import os
import socket
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, redirect_stdout
from dataclasses import replace
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from codec.errors import InvalidError
from codec.profiles.profile import Profile
from codec.storage.openfiles import Files, open_files
from codec.stream.manifest import Manifest
from trainer.run.config import LOCAL, TrainConfig
from trainer.run.outputs import check_targets
from trainer.run.prepare import Prepared, prepare

from .__main__ import FAILED
from .cut import cut
from .joiner import Joiner
from .task import STATE_FOLDER, Kind, Run, Task, whole_segments

log = logging.getLogger(__name__)

RUN_PATH = f"{STATE_FOLDER}/run.json"

LOOK_S = 0.5
"""How often progress is looked at, seconds."""

CONNECT_S = 10.0
"""How long the head of a cluster may take to answer, seconds."""

MAX_WORDS_CHARS = 2_000
"""Of what a process said when it failed."""

MAX_DEATHS = 30
"""Times that the process of a task may be killed before a worker gives up."""


def plan(config: TrainConfig, prepared: Prepared) -> Run:
    """The parts of a run. Raises InvalidError for settings that no parts can be made of."""
    if config.profile is not Profile.LATTICE or config.fit.swin_size != 1:
        raise InvalidError(
            "--ray joins parts slot by slot: choose profile lattice and swin_size 1, the defaults"
        )
    if config.raw_stream is not None:
        raise InvalidError("--ray makes one stream; leave --raw-stream out")
    segment_frames = config.segment_frames
    seam_frames = whole_segments(config.seam_frames, segment_frames)
    parts = cut(len(prepared.frames), config.part_frames, segment_frames, seam_frames)
    return Run(config, tuple(parts))


def train_in_parts(config: TrainConfig, address: str, console: Console) -> Manifest:
    """Trains `config.capture` into `config.stream` on the cluster at `address`.

    Raises SwingsError; then what is there by then stays, and --resume goes on from it.
    """
    config.check_profile()
    files = open_files(config.target)
    check_targets(config)
    afresh = replace(config, resume=False)  # as workers are told it
    with console.status("what the cameras see"):
        run = plan(afresh, prepare(afresh))
    try:
        with _cluster(address, config.worker_cpus) as ray:
            resumed = _begin(run, files, config.resume)
            return _train(run, files, resumed, ray, console)
    except KeyboardInterrupt:
        console.print("stopped; --resume goes on from there", highlight=False)
        raise


def _begin(run: Run, files: Files, resume: bool) -> bool:
    """Notes what is trained; whether something of it is there."""
    told = Task(run, Kind.GENESIS).to_json().encode()
    if not resume:
        files.put(RUN_PATH, told)
        return False
    if not files.holds(RUN_PATH):
        raise InvalidError(f"{files.name}: no run in parts was begun there; leave --resume out")
    if files.read(RUN_PATH, len(told) + (1 << 20)) != told:
        raise InvalidError(f"{files.name}: --resume wants the options of the run that it goes on")
    return True


@contextmanager
def _cluster(address: str, least_cpus: float) -> Iterator[Any]:
    """The cluster at `address`; one of this machine alone has `least_cpus` in any case."""
    try:
        import ray
    except ImportError as error:
        raise InvalidError("--ray needs the extra ray: pip install 'swings[ray]'") from error
    options: Mapping[str, Any] = {"address": address}
    if address == LOCAL:
        options = {"num_cpus": max(os.cpu_count() or 1, math.ceil(least_cpus))}
    _check_listens(address)
    try:
        ray.init(log_to_driver=False, logging_level=logging.ERROR, **options)
    except (ConnectionError, ValueError, RuntimeError) as error:
        raise InvalidError(f"--ray {address}: {error}") from error
    with redirect_stdout(sys.stderr):  # where Ray tells of workers that died
        try:
            yield ray
        finally:
            ray.shutdown()


def _check_listens(address: str) -> None:
    """Raises InvalidError where nobody listens at HOST:PORT; Ray would try for minutes."""
    host, colon, port = address.removeprefix("ray://").rpartition(":")
    if not colon or not port.isdigit():
        return  # auto and local, and whatever else Ray knows
    try:
        socket.create_connection((host.strip("[]"), int(port)), CONNECT_S).close()
    except (OSError, OverflowError) as error:
        raise InvalidError(f"--ray {address}: no cluster answers there: {error}") from error


class _Tally:
    """Counts, on the cluster, the iterations that tasks have done; what is done again counts
    once."""

    def __init__(self) -> None:
        self._done: dict[str, int] = {}

    def begin(self, task: str) -> None:
        self._done[task] = 0

    def add(self, task: str, iterations: int) -> None:
        self._done[task] += iterations

    def total(self) -> int:
        return sum(self._done.values())


def do(task: Task, tally: Any, *after: object) -> None:
    """Does a task in a process of its own, again if that is killed. tally: the actor. after: what
    was done before it. Raises InvalidError where another try would be of no use."""
    for _ in range(MAX_DEATHS):
        tally.begin.remote(task.name)
        status, words = run_task(task, lambda n: tally.add.remote(task.name, n))
        if not status:
            return
        if status == FAILED:
            break
    raise InvalidError(words or f"its process ended with {status}, {MAX_DEATHS} times")


def run_task(task: Task, tell: Callable[[int], object]) -> tuple[int, str]:
    """Does a task in a process of its own; gives its exit status and its last words."""
    with tempfile.NamedTemporaryFile("w", suffix=".json") as told, tempfile.TemporaryFile() as said:
        told.write(task.to_json())
        told.flush()
        process = subprocess.Popen(
            [sys.executable, "-m", "trainer.parts", told.name],
            stdin=subprocess.PIPE,  # ends when this process does
            stdout=subprocess.PIPE,
            stderr=said,
            text=True,
        )
        with process:
            assert process.stdout is not None
            for line in process.stdout:
                tell(int(line))
        said.seek(0)
        words = said.read().decode(errors="replace").strip()[-MAX_WORDS_CHARS:]
    return process.returncode, words


def _train(run: Run, files: Files, resumed: bool, ray: Any, console: Console) -> Manifest:
    # Ray does again what a worker did that died; what else goes wrong would go wrong again.
    remote = ray.remote(num_cpus=run.config.worker_cpus, max_retries=-1)(do)
    tally = ray.remote(num_cpus=0, max_restarts=-1)(_Tally).remote()
    joiner = Joiner(run, files)
    waiting: dict[Any, Task] = {}
    refs: dict[str, Any] = {}

    def start(task: Task, *after: Task) -> None:
        if files.holds(task.last_path):
            return
        needed = [refs[other.name] for other in after if other.name in refs]
        ref = refs[task.name] = remote.remote(task, tally, *needed)
        waiting[ref] = task

    genesis = Task(run, Kind.GENESIS)
    start(genesis)
    for part in run.parts:
        start(genesis.other(Kind.PART, part.number), genesis)
        if part.number:
            both = (genesis.other(Kind.PART, number) for number in (part.number - 1, part.number))
            start(genesis.other(Kind.SEAM, part.number), *both)
    with _progress(console) as bar:
        shown = bar.add_task(f"{len(run.parts)} parts", total=_iterations(run, waiting.values()))
        begun = genesis not in waiting.values()
        if begun:
            joiner.begin(resumed)
        while waiting:
            done, _ = ray.wait(list(waiting), timeout=LOOK_S)
            for ref in done:
                _check(ray, ref, waiting.pop(ref))
                if not begun:
                    joiner.begin(resumed)
                    begun = True
            if begun:
                for task in joiner.go_on():
                    _tidy(files, task)
            bar.update(shown, completed=ray.get(tally.total.remote()))
    joiner.go_on()
    return joiner.finish()


def _check(ray: Any, ref: Any, task: Task) -> None:
    """Raises what a task has raised."""
    try:
        ray.get(ref)
    except ray.exceptions.RayTaskError as error:
        cause = error.cause
        if isinstance(cause, InvalidError):
            raise InvalidError(f"{task.name}: {cause}") from error
        raise


def _tidy(files: Files, task: Task) -> None:
    """Deletes what nobody needs any more once the segments of `task` are in the index."""
    if task.kind is Kind.PART:
        files.delete(task.state_path("checkpoint"))
        return
    files.delete(task.other(Kind.PART, task.number - 1).state_path("end"))
    files.delete(task.other(Kind.PART, task.number).state_path("approach"))


def _iterations(run: Run, tasks: Iterable[Task]) -> int:
    """Of all `tasks`."""
    fit, total = run.config.fit, 0
    for task in tasks:
        part = task.part
        match task.kind:
            case Kind.GENESIS:
                total += fit.iterations(0)
            case Kind.PART:
                warm = min(run.config.warm_frames, part.first_frame - 1) if part.number else -1
                total += (part.end_frame - part.first_frame + warm) * fit.iterations(1)
            case Kind.SEAM:
                total += run.seam_frames * run.seam_fit.iterations(1)
    return total


def _progress(console: Console) -> Progress:
    return Progress(
        TextColumn("{task.description}"), BarColumn(), TextColumn("{task.percentage:.0f} %"),
        TimeElapsedColumn(), TimeRemainingColumn(), console=console, transient=True,
    )  # fmt: skip
