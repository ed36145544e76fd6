"""A study: all policies over all cases, each a trace at a load, on as many processes as asked for.

The load is what the link carries over what the stream needs with all layers. The trace is scaled
to it, so that a stream meets links that are too slow, just right and fast whatever its bitrate is.
What counts is the mean rate of the trace where a play uses it: its first LOAD_WINDOW lengths of the
play, for with its stalls a play takes longer than it shows. Of a trace of ten minutes the mean says
little about the minute that is played.
"""

from __future__ import annotations

import math
import multiprocessing
import os
import signal
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from functools import partial
from itertools import chain
from statistics import fmean
from typing import TypeVar

from codec.errors import InvalidError, SwingsError
from server.abr.link import Link
from server.abr.playout import PlayoutClock
from server.abr.traces import scaled

from .choice import make_policy, short_name
from .config import Rules, StudyConfig
from .looped import LoopedMedia, open_media
from .qoe import score
from .simulator import Shown, Simulated, play_out, simulate
from .tracefolder import Trace, generated_traces, read_traces

LOAD_WINDOW = 1.5
"""Lengths of the play over which the mean rate of a trace is taken."""
LEAST_LOAD, MOST_LOAD = 0.05, 100.0
MOST_S = 20_000.0
"""Virtual seconds after which a play that has not ended never will."""
DB_DIGITS, DIGITS = 4, 6
"""What is kept is rounded, so that the last digits of a processor are in no table."""


@dataclass(frozen=True, slots=True)
class Case:
    """One trace at one load."""

    trace: str
    load: float
    link: Link


@dataclass(frozen=True, slots=True)
class Play:
    """How one policy did in one case: a row of plays.csv."""

    trace: str
    load: float
    policy: str
    quality_db: float
    """QoE, see `score`."""
    psnr_db: float
    """Mean over the frames."""
    low_psnr_db: float
    """5th percentile of the frames."""
    rebuffering: float
    """Seconds of stalls for each second shown; without the start."""
    startup_s: float
    stalls: int
    step_db: float
    """Mean step between stretches of half a second, of the PSNR lost against all layers: how much
    it switches."""
    layers: float
    """Mean over the frames; a part of a layer counts as that part."""
    came_bytes: float


def at_load(trace: Trace, load: float, media: LoopedMedia) -> Case:
    """The case of `trace` at `load`. Raises InvalidError where nothing passes in time."""
    if not LEAST_LOAD <= load <= MOST_LOAD:
        raise InvalidError(f"load is {load:g}; it must be {LEAST_LOAD:g} to {MOST_LOAD:g}")
    window_s = min(trace.link.round_s, LOAD_WINDOW * media.length_s)
    mean_bps = 8 * trace.link.capacity_bytes(0.0, window_s) / window_s
    factor = load * media.need_bps / mean_bps if mean_bps else math.inf
    if not math.isfinite(factor):
        raise InvalidError(
            f"trace {trace.name}: no data passes in its first {window_s:g} s; leave it out"
        )
    return Case(trace.name, load, scaled(trace.link, factor))


def run_play(
    media: LoopedMedia, case: Case, policy: str, rules: Rules
) -> tuple[Simulated, list[Shown], PlayoutClock]:
    """A whole play. Raises InvalidError where it does not end, or where the policy fails."""
    try:
        result = simulate(media, make_policy(policy), case.link, rules.session, at_most_s=MOST_S)
    except SwingsError:
        raise
    except Exception as error:  # whatever a file of somebody's does
        raise InvalidError(f"policy {policy}: {type(error).__name__}: {error}") from error
    shown, clock = play_out(media, result, rules.session, 0, media.num_frames)
    if len(shown) < media.num_frames:
        raise InvalidError(
            f"trace {case.trace} at load {case.load:g}: {policy} has shown {len(shown)} of "
            f"{media.num_frames} frames after {MOST_S:g} s; leave the trace out or raise the load"
        )
    return result, shown, clock


def score_play(media: LoopedMedia, case: Case, policy: str, rules: Rules) -> Play:
    """How `policy` does in `case`."""
    result, shown, clock = run_play(media, case, policy, rules)
    assert clock.started_s is not None, "all frames have shown"
    psnr_db, best_db = [one.psnr_db for one in shown], media.best_db(range(media.num_frames))
    stalled_s = clock.stalled_s
    qoe = score(psnr_db, best_db, media.fps, clock.started_s, stalled_s, clock.stalls, rules.qoe)
    return Play(
        trace=case.trace,
        load=case.load,
        policy=short_name(policy),
        quality_db=round(qoe.quality_db, DB_DIGITS),
        psnr_db=round(qoe.psnr_db, DB_DIGITS),
        low_psnr_db=round(qoe.low_psnr_db, DB_DIGITS),
        rebuffering=round(qoe.stalled_s / media.length_s, DIGITS),
        startup_s=round(qoe.startup_s, DIGITS),
        stalls=qoe.stalls,
        step_db=round(qoe.step_db, DB_DIGITS),
        layers=round(fmean(one.layers for one in shown), DB_DIGITS),
        came_bytes=round(math.fsum(arrival.num_bytes for arrival in result.arrivals)),
    )


def score_plays(
    media: LoopedMedia, rules: Rules, policies: Sequence[str], case: Case
) -> list[Play]:
    """How all `policies` do in `case`."""
    return [score_play(media, case, policy, rules) for policy in policies]


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
