"""`swings-train --ray`: a run in parts on a Ray cluster, from the driver's side.

Ray decides where each task is done, and has it done again where its worker died.
"""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
from dataclasses import replace
from typing import Any

from rich.console import Console

from codec.errors import InvalidError
from codec.profiles.profile import Profile
from codec.storage.openfiles import Files, open_files
from codec.stream.manifest import Manifest
from trainer.run.config import TrainConfig
from trainer.run.outputs import check_targets
from trainer.run.prepare import Prepared, prepare
from trainer.run.progressline import ProgressLine
from trainer.run.runlog import LOG_NAME, RunLog

from .cluster import look_for_room, open_cluster
from .cut import cut
from .joiner import Joiner
from .joinmonitor import JoinMonitor
from .task import STATE_FOLDER, Kind, Run, Task, whole_segments
from .taskprocess import Tally, do

RUN_PATH = f"{STATE_FOLDER}/run.json"

LOOK_S = 0.5
"""How often progress is looked at, seconds."""


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
        prepared = prepare(afresh)
        run = plan(afresh, prepared)
    try:
        with open_cluster(address, config.worker_cpus) as ray:
            look_for_room(ray, config, console)
            resumed = _begin(run, files, config.resume)
            log_path = config.log or config.work_folder / LOG_NAME
            with ProgressLine(console) as line, RunLog(log_path, config.tensorboard) as runlog:
                monitor = JoinMonitor(line, runlog, len(prepared.frames))
                return _train(run, files, resumed, ray, monitor)
    except KeyboardInterrupt:
        console.print("stopped; --resume goes on from there", highlight=False)
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
        raise InvalidError(f"{files.name}: no run in parts was begun there; leave --resume out")
    if files.read(RUN_PATH, len(told) + (1 << 20)) != told:
        raise InvalidError(f"{files.name}: --resume wants the options of the run that it goes on")
    return True


def _train(run: Run, files: Files, resumed: bool, ray: Any, monitor: JoinMonitor) -> Manifest:
    config = run.config
    claims = {"num_cpus": config.worker_cpus, "num_gpus": config.worker_gpus}
    # Ray does again what a worker did that died; what else goes wrong would go wrong again.
    remote = ray.remote(max_retries=-1, **claims)(do)
    tally = ray.remote(num_cpus=0, max_restarts=-1)(Tally).remote()
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
    monitor.begin(_iterations(run, waiting.values()))
    begun = genesis not in waiting.values()
    if begun:
        monitor.found(joiner.begin(resumed))
    while waiting:
        done, _ = ray.wait(list(waiting), timeout=LOOK_S)
        for ref in done:
            _check(ray, ref, waiting.pop(ref))
            if not begun:
                monitor.found(joiner.begin(resumed))
                begun = True
        with suppress(ray.exceptions.RayActorError):  # it is being started anew
            monitor.progressed(ray.get(tally.total.remote()))
        if begun:
            for task, records in joiner.go_on():
                monitor.joined(records)
                _tidy(files, task)
    for _, records in joiner.go_on():
        monitor.joined(records)
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
    usual, in_seam = run.config.fit.iterations(1), run.seam_fit.iterations(1)
    total = 0
    for task in tasks:
        part = task.part
        match task.kind:
            case Kind.GENESIS:
                total += run.config.fit.iterations(0)
            case Kind.PART:
                warm = min(run.config.warm_frames, part.first_frame - 1) if part.number else -1
                total += (part.end_frame - run.seam_end(part) + warm) * usual
                total += (run.seam_end(part) - part.first_frame) * in_seam
            case Kind.SEAM:
                total += run.seam_frames * in_seam
    return total
