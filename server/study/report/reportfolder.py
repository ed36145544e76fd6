"""The folder of a report: index.html for people, plays.csv and summary.json for tools.

Rule: nothing in it says when or where it was made, so equal runs give equal bytes.
"""

from __future__ import annotations

import csv
import io
import json
import math
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

from codec.errors import InvalidError
from codec.files import temporary_beside, write_atomic
from server.study.plays import Oracle, Outcome, Play

from .summary import LoadSummary

DIGITS = 6


def check_absent(folder: Path) -> None:
    """Raises InvalidError unless a report can be put at `folder`."""
    if folder.exists() and not (folder.is_dir() and not any(folder.iterdir())):
        raise InvalidError(f"{folder} is not empty; remove it or name another folder")
    temporary_beside(folder)


def write_folder(folder: Path, files: Mapping[str, str]) -> None:
    """Puts `files`, text by name, at `folder`, absent or empty: all of them or none."""
    check_absent(folder)
    temporary = temporary_beside(folder)
    folder.parent.mkdir(parents=True, exist_ok=True)
    if temporary.exists():
        shutil.rmtree(temporary)  # of a run that was killed
    try:
        temporary.mkdir()
        for name, text in files.items():
            write_atomic(temporary / name, text.encode(errors="replace"))
        temporary.rename(folder)
    except BaseException:
        shutil.rmtree(temporary, ignore_errors=True)
        raise


def plays_csv(outcomes: Sequence[Outcome]) -> str:
    """A row for each play; what the oracle says of its case follows in columns `oracle_...`."""
    written = io.StringIO()
    table = csv.writer(written, lineterminator="\n")
    of_play = [field.name for field in fields(Play)]
    of_oracle = [field.name for field in fields(Oracle)]
    table.writerow(["trace", "load", *of_play, *(f"oracle_{name}" for name in of_oracle)])
    for outcome in outcomes:
        for play in outcome.plays:
            table.writerow(
                [
                    outcome.trace,
                    f"{outcome.load:g}",
                    *(_cell(getattr(play, name)) for name in of_play),
                    *(_cell(getattr(outcome.oracle, name)) for name in of_oracle),
                ]
            )
    return written.getvalue()


def _cell(value: object) -> str:
    if isinstance(value, float):
        return "" if math.isnan(value) else f"{value:.10g}"
    return str(value)


def summary_json(facts: Mapping[str, Any], summaries: Sequence[LoadSummary]) -> str:
    """The settings, and what the table says in full; null where there is no number."""
    value = {**facts, "loads": [asdict(summary) for summary in summaries]}
    return json.dumps(_rounded(value), indent=1, allow_nan=False) + "\n"


def _rounded(value: Any) -> Any:
    if isinstance(value, float):
        return round(value, DIGITS) if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {key: _rounded(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_rounded(one) for one in value]
    return value
