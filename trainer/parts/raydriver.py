"""`swings-train --ray`: a run in parts on a Ray cluster, from the driver's side.

Ray decides where each task is done, and has it done again where its worker died.
"""

from __future__ import annotations

import logging
from contextlib import suppress
from dataclasses import replace
from typing import Any

from rich.console import Console

from codec.errors import InvalidError
from codec.profiles.profile import Profile
from codec.storage.openfiles import Files, open_files
from codec.stream.manifest import Manifest
from trainer.run.config import TrainConfig
from trainer.run.finished import finish_outputs, show_finished
from trainer.run.outputs import check_targets
from trainer.run.prepare import Prepared, prepare
from trainer.run.progressline import ProgressLine
from trainer.run.runlog import LOG_NAME, RunLog

from .cluster import look_for_room, num_workers, open_cluster
from .cut import cut
from .joiner import Joiner
from .joinmonitor import JoinMonitor
from .joinpictures import JoinPictures
from .task import STATE_FOLDER, Kind, Run, Task, whole_segments
from .taskprocess import Tally, do
from .taskqueue import TaskQueue

log = logging.getLogger(__name__)

RUN_PATH = f"{STATE_FOLDER}/run.json"

LOOK_S = 0.5
"""How often progress is looked at, seconds."""

AHEAD = 2
"""Tasks that the cluster is given, over the workers that it has room for: the others wait there, so
that no worker does, and so that a cluster that can grow sees why."""


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

    A resumed run that is finished already is left as it is. Raises SwingsError; then what is there
    by then stays, and --resume goes on from it.
    """
    config.check_profile()
    files = open_files(config.target)
    if config.resume:
        finished = finish_outputs(config)
        if finished is not None:
            files.delete(STATE_FOLDER)  # a driver killed at its end may have left it
            show_finished(config, console)
            return finished
    check_targets(config)
    afresh = replace(config, resume=False)  # as workers are told it
    with console.status("reading what the cameras see"):
        prepared = prepare(afresh)
        run = plan(afresh, prepared)
    try:
        with open_cluster(address, config.worker_cpus, console) as ray:
            for doubt in () if config.resume else prepared.doubts:
                log.warning(doubt)
            look_for_room(ray, config, console)
            resumed = _begin(run, files, config.resume)
            log_path = config.log or config.work_folder / LOG_NAME
            with ProgressLine(console) as line, RunLog(log_path, config.tensorboard) as runlog:
                monitor = JoinMonitor(line, runlog, len(prepared.frames))
                pictures = JoinPictures(config, prepared)
                return _train(run, files, resumed, ray, monitor, pictures)
    except KeyboardInterrupt:
        with suppress(OSError):  # the terminal may be gone
            console.print("stopped; --resume continues from there", highlight=False)
        raise


def _begin(run: Run, files: Files, resume: bool) -> bool:
    """Notes what is trained; whether something of it is there."""
    # Without what changes no byte.
    config = replace(
        run.config, worker_cpus=1, worker_gpus=0, cache_bytes=0, log=None, tensorboard=None,
        snapshot_every=0,
    )  # fmt: skip
    told = Task(replace(run, config=config), Kind.GENESIS).to_json().encode()
    if not resume:
        files.put(RUN_PATH, told)
        return False
    if not files.holds(RUN_PATH):
        raise InvalidError(f"{files.name}: no run with --ray was started there; leave --resume out")
    if files.read(RUN_PATH, len(told) + (1 << 20)) != told:
        raise InvalidError(f"{files.name}: --resume needs the options of the run that it continues")
    return True


def _train(
    run: Run, files: Files, resumed: bool, ray: Any, monitor: JoinMonitor, pictures: JoinPictures
) -> Manifest:
    config = run.config
    claims = {"num_cpus": config.worker_cpus, "num_gpus": config.worker_gpus}
    # Ray does again what a worker did that died; what else goes wrong would go wrong again.
    remote = ray.remote(max_retries=-1, **claims)(do)
    tally = ray.remote(num_cpus=0, max_restarts=-1)(Tally).remote()
    joiner = Joiner(run, files)
    queue = TaskQueue(run, lambda task: files.holds(task.last_path))
    monitor.begin(sum(task.iterations for task in queue.waiting))
    begun = False
    given: dict[Any, Task] = {}
    while True:
        if not begun and queue.is_done(Task(run, Kind.GENESIS)):
            monitor.found(joiner.begin(resumed))
            begun = True
        if begun:
            for joined, records in joiner.go_on():
                monitor.joined(records)
                pictures.joined(records)
                _tidy(files, joined)
        most = AHEAD * max(1, num_workers(ray, config))
        while len(given) < most and (task := queue.take()) is not None:
            given[remote.remote(task, tally)] = task
        if not given:
            return joiner.finish()
        done, _ = ray.wait(list(given), timeout=LOOK_S)
        for ref in done:
            _check(ray, ref, given[ref])
            queue.done(given.pop(ref))
        with suppress(ray.exceptions.RayActorError):  # it is being started anew
            monitor.progressed(ray.get(tally.total.remote()))


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
