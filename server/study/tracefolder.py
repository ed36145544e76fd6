"""The traces that are played over: a folder of files, or made up.

Rule: which traces are taken goes by their names alone, so it is the same on any machine.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path, PurePosixPath
from typing import Literal

from codec.errors import InvalidError
from codec.files import read_bounded
from server.abr.link import Link
from server.abr.traces import MAX_TRACE_BYTES, parse_trace

from .generate import GeneratorConfig, generate

GENERATED = "generated"
"""The folder, so to speak, of made-up traces."""
NOT_TRACES = {".md"}
"""Suffixes of files that may lie among traces."""

Half = Literal["all", "tune", "report"]


@dataclass(frozen=True, slots=True)
class Trace:
    """A link by its name."""

    name: str
    """Where it lies in the folder of traces, with slashes."""
    link: Link


def chosen_names(names: Sequence[str], half: Half, per_folder: int) -> list[str]:
    """The `names` whose traces are played, folder by folder, sorted.

    Of the sorted names of a folder the first, third, ... are the half `tune`, the others are
    `report`. per_folder: at most so many of each folder, evenly spread; 0 for all.
    """
    first, step = {"all": (0, 1), "tune": (0, 2), "report": (1, 2)}[half]
    ordered = sorted(names, key=lambda name: (_folder(name), name))
    chosen: list[str] = []
    for _, folder in groupby(ordered, _folder):
        found = list(folder)[first::step]
        count = min(per_folder or len(found), len(found))
        chosen += [found[n * len(found) // count] for n in range(count)]
    return chosen


def _folder(name: str) -> str:
    return PurePosixPath(name).parent.as_posix()


def read_traces(folder: Path, half: Half, per_folder: int, latency_s: float) -> list[Trace]:
    """The traces in `folder` and all folders below, hidden ones aside. latency_s: of a trace that
    says none. Raises a SwingsError that names the file."""
    if not folder.is_dir():
        raise InvalidError(f"{folder} is not a folder; name the folder of the traces")
    names = chosen_names(list(_file_names(folder)), half, per_folder)
    if not names:
        of_half = "" if half == "all" else f" in half {half!r}"
        raise InvalidError(f"{folder} holds no traces{of_half}")
    return [
        Trace(name, parse_trace(read_bounded(folder / name, MAX_TRACE_BYTES), name, latency_s))
        for name in names
    ]


def _file_names(folder: Path) -> Iterator[str]:
    for path in folder.rglob("*"):
        name = path.relative_to(folder)
        hidden = any(part.startswith(".") for part in name.parts)
        if path.is_file() and not hidden and path.suffix not in NOT_TRACES:
            if not str(name).isprintable():
                raise InvalidError(f"{str(path)!a}: the name has unprintable characters; rename it")
            yield name.as_posix()


def generated_traces(
    seeds: range, config: GeneratorConfig, half: Half, per_folder: int, latency_s: float
) -> list[Trace]:
    """Made-up links of `seeds`."""
    named = {f"{GENERATED}/{seed:06d}": seed for seed in seeds}
    names = chosen_names(list(named), half, per_folder)
    return [Trace(name, generate(config, named[name], latency_s)) for name in names]
