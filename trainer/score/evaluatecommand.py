"""The work of swings-eval by its config: scores, a table or JSON, or a film beside the capture."""

from __future__ import annotations

import json

from rich.console import Console

from codec.console import printing, say
from codec.progressline import counted

from .evaluate import EvaluateConfig, evaluate_stream
from .sheet import write_sheet


def run_evaluation(config: EvaluateConfig) -> None:
    """Prints what `config` asks for, and writes its files. Raises SwingsError."""
    if config.compare is not None:
        from .sidebyside import write_side_by_side  # loads matplotlib

        with counted("drawing") as note:
            found = write_side_by_side(config, *config.compare, note)
        say(found.line)
        return
    with counted("scoring") as note:
        result = evaluate_stream(config, note)
    if config.sheet is not None:
        write_sheet(config.stream, config.capture, config.sheet, config.max_gaussians)
    if config.json:
        say(json.dumps(result.to_json(), indent=1))
    else:
        with printing():
            Console().print(result.table())
