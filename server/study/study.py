"""A study: all policies over all cases, on as many processes as asked for."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from itertools import chain
from typing import TypeVar

from codec.errors import InvalidError, SwingsError

from .config import StudyConfig
from .looped import LoopedMedia, open_media
from .plays import Case, Play, at_load, score_plays
from .tracefolder import generated_traces, read_traces

Result = TypeVar("Result")
Progress = Callable[[int, int], None]
"""Takes the cases that are done, and how many there are."""


def run_study(config: StudyConfig, progress: Progress = lambda done, of: None) -> list[Play]:
    """Plays every case by every policy. Raises a SwingsError."""
    media, cases = open_cases(config)
    play = partial(score_plays, media, config.rules, config.policy)
    return list(chain.from_iterable(over_cases(play, cases, config.jobs, progress)))


def open_cases(config: StudyConfig) -> tuple[LoopedMedia, list[Case]]:
    """The stream, and all traces at the first load, then at the next. Raises a SwingsError."""
    media = open_media(config.stream, config.length_s)
    choice = config.half, config.per_folder, config.latency_s
    seeds = range(config.seed, config.seed + config.generate)
    traces = generated_traces(seeds, config.generator, *choice)
    if config.traces is not None:
        traces = read_traces(config.traces, *choice) + traces
    if not traces:
        raise InvalidError(
            f"none of {config.generate} generated traces is in half {config.half!r}; "
            "raise --generate"
        )
    return media, [at_load(trace, load, media) for load in config.loads for trace in traces]


def over_cases(
    work: Callable[[Case], Result], cases: Sequence[Case], jobs: int, progress: Progress
) -> list[Result]:
    """`work` of each case, in their order, by `jobs` processes; 0 for one per core."""
    done: list[Result] = []

    def note(result: Result) -> None:
        done.append(result)
        progress(len(done), len(cases))

    progress(0, len(cases))
    jobs = min(jobs or os.cpu_count() or 1, len(cases))
    if jobs == 1:
        for case in cases:
            note(work(case))
        return done
    # A forked process would inherit whatever threads the libraries have started.
    context = multiprocessing.get_context("spawn")
    # Ctrl-C is for the parent alone, which then ends them.
    quiet = (signal.SIGINT, signal.SIG_IGN)
    with ProcessPoolExecutor(jobs, context, signal.signal, quiet) as pool:
        try:
            for result in pool.map(work, cases):
                note(result)
        except BrokenProcessPool as error:
            raise SwingsError("a worker process was killed; give a lower --jobs") from error
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return done
