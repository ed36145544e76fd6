"""What swings-eval does with its config: scores, a table or JSON, or a film beside the capture."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import Progress

from codec.console import printing, say

from .ablation import ablate_quantisation
from .evaluate import EvaluateConfig, evaluate_stream
from .sheet import write_sheet


def run_evaluation(config: EvaluateConfig) -> None:
    """Prints what `config` asks for, and writes its files. Raises SwingsError."""
    if config.compare is not None:
        from .sidebyside import write_side_by_side  # loads matplotlib

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


@contextmanager
def _progress(what: str) -> Iterator[Callable[[int, int], None]]:
    """A progress bar; gives a function to call with (pictures done, pictures in all)."""
    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(what, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)
