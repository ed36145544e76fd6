"""`swings-train --ray`: a run in parts on a Ray cluster, from the driver's side.

Ray decides where each task is done, and has it done again where its worker died.
"""

from __future__ import annotations

import json
import logging
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import Any

from rich.console import Console

from codec.errors import InvalidError
from codec.progressline import ProgressLine
from codec.storage.growingplace import GrowingPlace
from codec.storage.openstorage import open_growing
from codec.stream.index import SegmentRecord
from codec.stream.manifest import Manifest
from codec.stream.writer import SHAPE
from trainer.run.capturesound import CaptureSound, capture_sound
from trainer.run.config import TrainConfig
from trainer.run.finished import finish_outputs, show_finished, show_result
from trainer.run.outputs import check_targets, writing_run
from trainer.run.prepare import Prepared, fps_of, prepare
from trainer.run.runlog import LOG_NAME, RunLog
from trainer.run.storedconfig import config_to_json

from .cluster import look_for_room, num_workers, open_cluster
from .cut import cut
from .joiner import Joiner
from .joinmonitor import JoinMonitor
from .joinpictures import draw_joined
from .raytask import Tally, remote_task, task_result
from .task import STATE_FOLDER, Kind, Run, Task, whole_segments
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
