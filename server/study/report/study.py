"""A study from its settings to its report: all cases, on as many processes as asked for."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import asdict
from functools import partial
from typing import Any

from codec.errors import InvalidError, SwingsError
from server.study.cases import Case, make_cases
from server.study.config import StudyConfig
from server.study.looped import LoopedMedia, open_media
from server.study.plays import Outcome, Rules, run_case
from server.study.tracefolder import Trace, generated_traces, read_traces

from .page import make_page
from .reportfolder import check_absent, plays_csv, summary_json, write_folder
from .summary import OWN, LoadSummary, summarise
from .timecourse import follow, telling_outcome, telling_policies


def run_study(
    config: StudyConfig, progress: Callable[[int, int], None] = lambda done, of: None
) -> list[LoadSummary]:
    """Plays everything, writes the report and gives its summary. progress: cases done, of how
    many. Raises a SwingsError, and then writes nothing."""
    check_absent(config.out)
    media = open_media(config.stream, config.length_s)
    if config.as_bitrate is not None:
        media = media.with_bitrate(config.as_bitrate)
    cases = make_cases(_traces(config), config.loads, media)
    chosen = _chosen_case(config.timeline, cases)
    rules = Rules(config.session, config.qoe)
    outcomes: list[Outcome] = []
    progress(0, len(cases))
    for outcome in _outcomes(config, media, cases, rules):
        outcomes.append(outcome)
        progress(len(outcomes), len(cases))
    summaries = summarise(outcomes, config.seed)
    own = OWN if OWN in config.policies else config.policies[0]
    shown = telling_outcome(outcomes, own) if chosen is None else outcomes[cases.index(chosen)]
    case = cases[outcomes.index(shown)]
    lines = [follow(media, case, policy, rules) for policy in telling_policies(shown)]
    page = make_page(_settings(config, media), outcomes, summaries, lines, rules)
    facts = _facts(config, media, rules, [outcome.trace for outcome in outcomes])
    files = {
        "plays.csv": plays_csv(outcomes),
        "summary.json": summary_json(facts, summaries),
        "index.html": page,
    }
    write_folder(config.out, files)
    return summaries


def _traces(config: StudyConfig) -> list[Trace]:
    traces: list[Trace] = []
    if config.traces is not None:
        traces += read_traces(config.traces, config.half, config.per_folder, config.latency_s)
    if config.generate:
        traces += generated_traces(
            config.generate, config.generator, config.seed, config.half, config.per_folder
        )
    if not traces:
        raise InvalidError(
            f"none of {config.generate} generated traces is in half {config.half!r}; "
            "raise --generate"
        )
    return traces


def _chosen_case(text: str, cases: Sequence[Case]) -> Case | None:
    """The case that `text`, TRACE@LOAD, names; None for an empty text."""
    if not text:
        return None
    found = next((case for case in cases if text == f"{case.trace}@{case.load:g}"), None)
    if found is None:
        first = cases[0]
        raise InvalidError(
            f"timeline {text!r} is not a simulated trace and load, such as "
            f"{first.trace}@{first.load:g}"
        )
    return found


def _outcomes(
    config: StudyConfig, media: LoopedMedia, cases: Sequence[Case], rules: Rules
) -> Iterator[Outcome]:
    """The outcomes of all cases, in their order."""
    play = partial(run_case, media, policies=config.policies, rules=rules)
    jobs = min(config.jobs or os.cpu_count() or 1, len(cases))
    if jobs == 1:
        yield from map(play, cases)
        return
    # A forked process would inherit whatever threads the libraries have started.
    context = multiprocessing.get_context("spawn")
    # Ctrl-C is for the parent alone, which then ends them.
    quiet = (signal.SIGINT, signal.SIG_IGN)
    with ProcessPoolExecutor(jobs, context, signal.signal, quiet) as pool:
        try:
            yield from pool.map(play, cases)
        except BrokenProcessPool as error:
            raise SwingsError("a worker process was killed; give a lower --jobs") from error
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def _settings(config: StudyConfig, media: LoopedMedia) -> list[tuple[str, str]]:
    """The study's settings, as names and texts for the page."""
    quality = "from the index" if media.knows_psnr else "estimated from the sizes"
    scaled = "" if config.as_bitrate is None else " after scaling the sizes"
    traces = "all" if config.half == "all" else f"half {config.half!r} of each folder"
    return [
        (
            "Stream",
            f"{config.stream.resolve().name}: {media.num_layers} layers, "
            f"{media.need_bps / 1e6:.3g} Mbit/s with all layers{scaled}; PSNR {quality}",
        ),
        ("Plays", f"{media.length_s:g} s each, from the first frame"),
        ("Traces", f"{traces}; {_per_folder(config)}seed {config.seed}"),
    ]


def _per_folder(config: StudyConfig) -> str:
    return f"at most {config.per_folder} of each folder; " if config.per_folder else ""


def _facts(
    config: StudyConfig, media: LoopedMedia, rules: Rules, names: Sequence[str]
) -> dict[str, Any]:
    """All inputs that the numbers depend on."""
    return {
        "stream": config.stream.resolve().name,
        "need_bps": media.need_bps,
        "knows_psnr": media.knows_psnr,
        "length_s": media.length_s,
        "policies": list(config.policies),
        "half": config.half,
        "per_folder": config.per_folder,
        "seed": config.seed,
        "traces": list(dict.fromkeys(names)),
        "session": asdict(rules.session),
        "qoe": asdict(rules.qoe),
        "latency_s": config.latency_s,
        "generator": asdict(config.generator) if config.generate else None,
    }
