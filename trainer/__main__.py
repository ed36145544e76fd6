"""swings-synth, swings-train and swings-eval: parse, build a config, run."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import Progress

from codec.console import printing, run_command, say

# Threads that wait must not spin: beside other work on few cores that costs more than it saves.
# It has to be said before the first parallel kernel runs.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")

from trainer.parts.raydriver import train_in_parts
from trainer.run.check import check_capture
from trainer.run.config import TrainConfig
from trainer.run.job import train_stream
from trainer.run.preset import parse_with_preset
from trainer.run.warm import start_over_if_compiled
from trainer.score.ablation import ablate_quantisation
from trainer.score.evaluate import EvaluateConfig, evaluate_stream
from trainer.score.sheet import write_sheet
from trainer.score.sidebyside import write_side_by_side
from trainer.synth.film import SynthConfig, synthesise


def _train(config: TrainConfig) -> None:
    console = Console(stderr=True)
    if config.check is not None:
        return say("\n".join(check_capture(config)))
    if config.ray is not None:
        train_in_parts(config, config.ray, console)
    else:  # bytes must not depend on whether this run compiles the kernels
        train_stream(config, console, lambda: start_over_if_compiled(config.fit.sh_degree, console))
    return say(str(config.target))


@contextmanager
def _progress(what: str) -> Iterator[Callable[[int, int], None]]:
    """A bar; gives what is to be told (pictures done, in all)."""
    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(what, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


def _evaluate(config: EvaluateConfig) -> None:
    if config.compare is not None:
        with _progress("drawing") as note:
            found = write_side_by_side(config, *config.compare, note)
        say(found.line)
        return
    score = ablate_quantisation if config.ablate_quantisation else evaluate_stream
    with _progress("scoring") as note:
        result = score(config, note)
    if config.sheet is not None:
        write_sheet(config.stream, config.capture, config.sheet, config.max_gaussians)
    if config.json:
        say(json.dumps(result.to_json(), indent=1))
    else:
        with printing():
            Console().print(result.table())


def synth() -> None:
    run_command(SynthConfig, synthesise, "swings-synth", "Makes a procedural capture to try with.")


def train() -> None:
    run_command(
        TrainConfig, _train, "swings-train", "Trains a capture into a stream.", parse_with_preset
    )


def evaluate() -> None:
    run_command(EvaluateConfig, _evaluate, "swings-eval", "Scores a stream against its capture.")
