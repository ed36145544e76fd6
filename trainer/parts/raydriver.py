"""`swings-train --ray`: a run in parts on a Ray cluster, from the driver's side, and the function
that Ray runs for each task.

Ray decides where a task is done, and has it done again where its worker died: each time in a worker
process of its own.
"""

from __future__ import annotations

import io
import json
import logging
import math
import os
import re
import secrets
import signal
import socket
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, redirect_stdout, suppress
from dataclasses import replace
from functools import partial
from typing import Any

from rich.console import Console

from codec.errors import InvalidError, SwingsError
from codec.progressline import ProgressLine
from codec.storage.openstorage import open_growing
from codec.storage.storage import GrowingPlace
from codec.stream.manifest import Manifest
from codec.stream.segment import SegmentRecord
from codec.stream.writer import SHAPE
from trainer.run.config import LOCAL, TrainConfig, config_to_json
from trainer.run.fromvideos import with_poses
from trainer.run.job import finish_outputs, show_finished, show_result
from trainer.run.monitor import LOG_NAME, RunLog
from trainer.run.outputs import CaptureSound, capture_sound, check_targets, writing_run
from trainer.run.prepare import Prepared, fps_of, prepare

from .joiner import Joiner, JoinMonitor, draw_joined
from .task import STATE_FOLDER, Kind, Run, Task, TaskQueue, cut, whole_segments

log = logging.getLogger(__name__)

CONNECT_S = 10.0
"""Timeout for the head of a cluster to answer, in seconds."""


@contextmanager
def open_cluster(address: str, least_cpus: float, console: Console) -> Iterator[Any]:
    """The cluster at `address`; one of this machine alone has `least_cpus` in any case. console:
    gets a line where a worker dies."""
    if address == LOCAL:
        # Ray listens on all interfaces, and runs what anyone sends. Versions before 2.52 ignore it.
        os.environ.setdefault("RAY_AUTH_MODE", "token")
        os.environ.setdefault("RAY_AUTH_TOKEN", secrets.token_hex(32))
    try:
        import ray
    except ImportError as error:
        raise InvalidError(
            "--ray needs the package ray: pip install '.[ray]' in the folder of swings"
        ) from error
    # Without an address Ray would join a cluster that RAY_ADDRESS or a killed driver's files name.
    options: dict[str, Any] = {"address": address}
    if address == LOCAL:
        options["num_cpus"] = max(os.cpu_count() or 1, math.ceil(least_cpus))
    _check_listens(address)
    try:
        with keeping_signals():
            ray.init(log_to_driver=False, logging_level=logging.ERROR, **options)
    except Exception as error:  # where a node does not start in time, Ray raises no narrower one
        raise InvalidError(f"--ray {address}: {' '.join(str(error).split())}") from error
    with redirect_stdout(RayOutput(console)):
        try:
            yield ray
        finally:
            ray.shutdown()


LOSSES = {
    "memory pressure": "a node ran out of memory and ended a worker",
    "A worker died": "{worker} was killed or crashed (out of memory, a signal, or native code)",
    "User exception": "a task failed{error}",
    "marked dead": "a node of the cluster is gone",
}
"""Messages of Ray, and their meaning for a user."""

_DEAD_WORKER = re.compile(r"Worker IP address: (\S+) .*Worker PID: (\d+)")
_ERROR = re.compile(r"^(\w+: .+)$", re.MULTILINE)


class RayOutput(io.TextIOBase):
    """Stands in for standard output, where Ray prints paragraphs about each worker that dies and
    each task that fails: prints one line for each, and logs the rest at level debug."""

    def __init__(self, console: Console) -> None:
        self._console = console

    def write(self, text: str) -> int:
        if text.strip():
            log.debug("ray: %s", text.strip())
        for words, meaning in LOSSES.items():
            if words in text:
                worker, error = "a worker", ""
                if found := _DEAD_WORKER.search(text):
                    worker = f"worker process {found[2]} on node {found[1]}"
                if found := _ERROR.search(text.partition("System error:")[0]):
                    error = f" ({found[1]})"
                line = meaning.format(worker=worker, error=error)
                line += "; its task is run again (--verbose shows Ray's message)"
                self._console.print(line, highlight=False, markup=False, soft_wrap=True)
                break
        return len(text)


@contextmanager
def keeping_signals() -> Iterator[None]:
    """Ray would end the process by itself when it is asked to end, without a word."""
    handler = signal.getsignal(signal.SIGTERM)
    try:
        yield
    finally:
        if handler is not None and threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGTERM, handler)


def look_for_room(ray: Any, config: TrainConfig, console: Console) -> None:
    """Says so where no node has what a worker claims: one may come, but until then all waits."""
    if not num_workers(ray, config):
        console.print(
            f"no node of the cluster has {config.worker_cpus:g} cores and {config.worker_gpus:g} "
            "GPUs for a worker (--worker-cpus, --worker-gpus): waiting for one",
            highlight=False, soft_wrap=True,
        )  # fmt: skip


def num_workers(ray: Any, config: TrainConfig) -> int:
    """Number of workers that fit on the nodes that are up now, if nothing else runs there."""
    claims = {"CPU": config.worker_cpus, "GPU": config.worker_gpus}
    return sum(
        min(int(node["Resources"].get(kind, 0) / much) for kind, much in claims.items() if much)
        for node in ray.nodes()
        if node["Alive"]
    )


def _check_listens(address: str) -> None:
    """Raises InvalidError if no process listens at HOST:PORT; Ray would try for minutes."""
    host, colon, port = address.removeprefix("ray://").rpartition(":")
    if not colon or not port.isdigit():
        return  # auto and local, and whatever else Ray knows
    try:
        socket.create_connection((host.strip("[]"), int(port)), CONNECT_S).close()
    except (OSError, OverflowError) as error:
        raise InvalidError(f"--ray {address}: no cluster answers: {error}") from error


MAX_RETRIES = 30
"""Times that Ray runs a task again before the whole run fails."""

PASSING = OSError, MemoryError, RuntimeError
"""Errors that another try may not meet: of disks, networks, memory and GPUs."""


class Tally:
    """An actor that knows how many iterations of each task are done."""

    def __init__(self) -> None:
        self._before: dict[str, int] = {}
        self._done: dict[str, int] = {}

    def report(self, task: str, iterations: int) -> None:
        self._before.setdefault(task, iterations)
        self._done[task] = iterations

    def totals(self) -> tuple[int, int]:
        """Iterations done, and those of them that an earlier run had done."""
        return sum(self._done.values()), sum(self._before.values())


def remote_task(ray: Any, config: TrainConfig) -> Any:
    """`do_task` as a remote function with the resources, threads and retries of `config`."""
    environment = {
        # Numba reads both once, when it is loaded: so a process for each task, and not one before.
        "NUMBA_NUM_THREADS": str(math.ceil(config.worker_cpus)),
        "OMP_WAIT_POLICY": "passive",  # see trainer/__main__.py
    }
    return ray.remote(
        num_cpus=config.worker_cpus,
        num_gpus=config.worker_gpus,
        max_calls=1,
        max_retries=MAX_RETRIES,
        retry_exceptions=list(PASSING),
        runtime_env={"env_vars": environment},
    )(do_task)


def do_task(task: Task, tally: Any, warm_nodes: frozenset[str]) -> str | None:
    """Does a task in a process of Ray. Raises InvalidError where another try would be of no use.

    A process that compiles kernels may round differently from those that load them. So where this
    one has compiled any, and its node is not one of `warm_nodes`, it leaves the task undone and
    gives the node's ID: the next process there loads them.
    """
    import ray

    from trainer.run.warm import compile_kernels

    from .worker import opened_worker

    if open_growing(task.run.config.target, SHAPE).holds(task.last_path):
        return None  # the process that finished it died before it could report that
    node: str = ray.get_runtime_context().get_node_id()
    if compile_kernels(task.run.config.fit.sh_degree) and node not in warm_nodes:
        return node
    try:
        with opened_worker(task, lambda n: tally.report.remote(task.name, n)) as worker:
            worker.work()
    except SwingsError as error:
        raise InvalidError(f"{task.name}: {error}") from error
    return None


def task_result(ray: Any, ref: Any, task: Task) -> str | None:
    """The result of `do_task`. Raises InvalidError where Ray has given up on it."""
    try:
        node: str | None = ray.get(ref)
    except ray.exceptions.RayTaskError as error:
        if isinstance(error.cause, InvalidError):
            raise error.cause from error
        if isinstance(error.cause, PASSING):
            words = f"{type(error.cause).__name__}: {error.cause}".splitlines()[0]
            raise InvalidError(f"{task.name}: {words}, {MAX_RETRIES + 1} times") from error
        raise
    except ray.exceptions.RayError as error:
        words = str(error).splitlines()[0]
        raise InvalidError(f"{task.name}: {words} ({MAX_RETRIES + 1} times)") from error
    return node


RUN_PATH = f"{STATE_FOLDER}/run.json"

LOOK_S = 0.5
"""How often progress is looked at, seconds."""

AHEAD = 2
"""Tasks that the cluster is given, over the workers that it has room for: the others wait there, so
that no worker does, and so that a cluster that can grow sees why."""


def plan(config: TrainConfig, prepared: Prepared) -> Run:
    """The parts of a run. Raises InvalidError for settings that no parts can be made of."""
    if config.whole_slices or config.fit.swin_size != 1:
        raise InvalidError(
            "--ray joins parts slot by slot; choose --no-whole-slices and --swin-size 1"
        )
    segment_frames = config.segment_frames
    seam_frames = whole_segments(config.seam_frames, segment_frames)
    parts = cut(len(prepared.frames), config.part_frames, segment_frames, seam_frames)
    return Run(config, tuple(parts))


def train_in_parts(config: TrainConfig, address: str, console: Console) -> Manifest:
    """Trains `config.capture` into `config.stream` on the cluster at `address`.

    A resumed run that is finished already is left as it is. Raises SwingsError; then what is there
    by then stays, and --resume goes on from it.
    """
    config.check_slices()
    if config.serve is not None:
        raise InvalidError(
            "--serve serves what this process trains; with --ray run swings-serve beside it"
        )
    with writing_run(config):
        return _train_alone(config, address, console)


def _train_alone(config: TrainConfig, address: str, console: Console) -> Manifest:
    """`train_in_parts`, where no other driver writes the stream."""
    files = open_growing(config.target, SHAPE)
    if config.resume:
        finished = finish_outputs(config)
        if finished is not None:
            files.delete(STATE_FOLDER)  # a driver killed at its end may have left it
            show_finished(config, console)
            return finished
    check_targets(config)
    config = with_poses(config, console)
    afresh = replace(config, resume=False)  # the config that workers get
    with console.status("reading what the cameras see"):
        prepared = prepare(afresh)
        doubts = [] if config.resume else prepared.find_doubts()
        run = plan(afresh, prepared)
    fps = partial(fps_of, prepared.capture, afresh)
    sound = capture_sound(afresh, prepared.capture, prepared.frames, fps)
    begin_s = time.monotonic()
    try:
        with open_cluster(address, config.worker_cpus, console) as ray:
            for doubt in doubts:
                log.warning(doubt)
            look_for_room(ray, config, console)
            resumed = _begin(run, files, config.resume)
            log_path = config.log or config.work_folder / LOG_NAME
            with ProgressLine(console) as line, RunLog(log_path, config.tensorboard) as runlog:
                monitor = JoinMonitor(line, runlog, len(prepared.frames))
                draw = partial(draw_joined, config, prepared)
                manifest = _train(run, sound, files, resumed, ray, monitor, draw)
    except KeyboardInterrupt:
        with suppress(OSError):  # the terminal may be gone
            console.print("stopped; --resume continues from there", highlight=False)
        raise
    show_result(config, time.monotonic() - begin_s, console)
    return manifest


def _begin(run: Run, files: GrowingPlace, resume: bool) -> bool:
    """Records the run's settings in `files`; whether a part of this run is there already."""
    # Settings that change no byte of the result are left out.
    config = replace(
        run.config, worker_cpus=1, worker_gpus=0, cache_bytes=0, log=None, tensorboard=None,
        snapshot_every=0,
    )  # fmt: skip
    parts = [[part.first_frame, part.end_frame] for part in run.parts]
    settings = json.dumps({"config": config_to_json(config), "parts": parts}).encode()
    if not resume:
        files.put(RUN_PATH, settings)
        return False
    if not files.holds(RUN_PATH):
        raise InvalidError(f"{files.name}: no run with --ray was started there; leave --resume out")
    if files.read(RUN_PATH, len(settings) + (1 << 20)) != settings:
        raise InvalidError(f"{files.name}: --resume needs the options of the run that it continues")
    return True


def _train(
    run: Run,
    sound: CaptureSound | None,
    files: GrowingPlace,
    resumed: bool,
    ray: Any,
    monitor: JoinMonitor,
    draw: Callable[[Sequence[SegmentRecord]], None],
) -> Manifest:
    config = run.config
    remote = remote_task(ray, config)
    tally = ray.remote(num_cpus=0, max_restarts=-1)(Tally).remote()
    joiner = Joiner(run, sound)
    queue = TaskQueue(run, lambda task: files.holds(task.last_path))
    monitor.begin(sum(task.iterations for task in queue.waiting))
    begun = False
    given: dict[Any, Task] = {}
    warm_nodes: set[str] = set()

    def give(task: Task) -> None:
        given[remote.remote(task, tally, frozenset(warm_nodes))] = task

    while True:
        if not begun and queue.is_done(Task(run, Kind.GENESIS)):
            monitor.found(joiner.begin(resumed))
            _tidy(files, Task(run, Kind.GENESIS))
            begun = True
        if begun:
            for joined, records in joiner.go_on():
                monitor.joined(records)
                draw(records)
                _tidy(files, joined)
        most = AHEAD * max(1, num_workers(ray, config))
        while len(given) < most and (task := queue.take()) is not None:
            give(task)
        if not given:
            return joiner.finish()
        done, _ = ray.wait(list(given), timeout=LOOK_S)
        for ref in done:
            task = given.pop(ref)
            node = task_result(ray, ref, task)
            if node is None:
                queue.done(task)
            else:
                warm_nodes.add(node)
                give(task)
        with suppress(ray.exceptions.RayActorError):  # it is being started anew
            monitor.progressed(*ray.get(tally.totals.remote()))


def _tidy(files: GrowingPlace, task: Task) -> None:
    """Deletes what no task needs any more once `task` is done and its segments are in the index."""
    files.delete(task.state_path("checkpoint"))
    if task.kind is not Kind.SEAM:
        return
    files.delete(task.other(Kind.PART, task.number - 1).state_path("end"))
    for birth in task.frames:
        files.delete(task.other(Kind.PART, task.number).state_path(f"approach-{birth}"))
