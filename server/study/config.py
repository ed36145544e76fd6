"""The settings of swings-abr; every default is defined here once."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, ClassVar

import tyro

from codec.console import option
from codec.errors import InvalidError
from codec.helptext import Groups
from server.abr.link.ratetext import RATE_PATTERN, rate_bps
from server.abr.session import SessionConfig
from server.study.policies.choice import POLICIES
from server.study.simulate.generate import GeneratorConfig
from server.study.simulate.qoe import QoeConfig

from .cases import LOADS
from .tracefolder import Half

MAX_LENGTH_S = 3600.0
MAX_GENERATED = 10_000


def parse_policies(text: str) -> tuple[str, ...]:
    """`all`, or names with commas between them, in the order of POLICIES. Raises InvalidError."""
    if text == "all":
        return tuple(POLICIES)
    names = text.split(",")
    for name in names:
        if name not in POLICIES:
            raise InvalidError(
                f"policy {name!r} is unknown; choose from {', '.join(POLICIES)}, or all"
            )
    return tuple(name for name in POLICIES if name in names)


def parse_bitrate(text: str) -> float:
    """Bits per second, as `36M`. Raises InvalidError."""
    match = re.fullmatch(RATE_PATTERN, text)
    if not match or not float(match[1]):
        raise InvalidError(f"bitrate {text!r} is not a number over 0 with k, M or G, such as 36M")
    return rate_bps(match[1], match[2])


POLICY_NAMES = option("all|A,B,...", parse_policies, ",".join)
BITRATE = option(
    "RATE",
    parse_bitrate,
    lambda rate_bps: "as it is" if rate_bps is None else f"{rate_bps / 1e6:g}M",
)


@dataclass(frozen=True, slots=True)
class StudyConfig:
    """The plays to simulate, and the folder of the report."""

    EVERYDAY: ClassVar[Groups] = {
        "Report": ("out", "policies", "timeline"),
        "Links": ("traces", "generate", "loads", "half", "per-folder", "latency-s"),
        "Plays": ("length", "as-bitrate", "jobs", "seed"),
    }

    stream: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="STREAM")]]
    """Folder of a stream; only its manifest and index are read."""
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")]
    """Folder of the report; it must be absent or empty."""
    traces: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """Folder of throughput traces, and its subfolders: JSON as in Sabre, or text as in Mahimahi."""
    generate: int = 0
    """Number of generated traces, in addition to those of the folder or instead of them."""
    policies: Annotated[tuple[str, ...], POLICY_NAMES] = tuple(POLICIES)
    """Policies to compare, separated by commas."""
    loads: tuple[float, ...] = LOADS
    """Ratios of the link's rate to the rate of the stream with all layers. The mean rate of each
    trace is scaled to each ratio."""
    half: Half = "all"
    """Traces to use: tune for the first, third, ... of each folder, by name; report for the other
    half."""
    per_folder: int = 0
    """Maximum traces from each folder, evenly spread; 0 for all."""
    length_s: Annotated[float, tyro.conf.arg(name="length")] = 60.0
    """Seconds of each play; a shorter stream is repeated."""
    as_bitrate: Annotated[float | None, BITRATE] = None
    """Scale the sizes so that the stream with all layers has this bitrate, such as 36M."""
    timeline: Annotated[str, tyro.conf.arg(metavar="TRACE@LOAD")] = ""
    """The case to draw over time; if empty, a case in the middle."""
    seed: int = 0
    """Seed of the generated traces and of the bootstrap."""
    jobs: int = 0
    """Worker processes; 0 for one per core. The report does not depend on their number."""
    latency_s: float = 0.02
    """Latency of traces without one, such as Mahimahi's, seconds."""
    session: SessionConfig = field(default_factory=SessionConfig)
    """Pacing of plays."""
    qoe: QoeConfig = field(default_factory=QoeConfig)
    """Costs of waiting and of quality changes."""
    generator: GeneratorConfig = field(default_factory=GeneratorConfig)
    """Properties of the generated traces."""

    def __post_init__(self) -> None:
        if not self.loads or len(set(self.loads)) < len(self.loads):
            raise InvalidError(f"loads are {self.loads}; give at least one, each only once")
        if not 0 < self.length_s <= MAX_LENGTH_S:
            raise InvalidError(f"length is {self.length_s}; give over 0, at most {MAX_LENGTH_S:g}")
        for name in ("generate", "per_folder", "seed", "jobs"):
            if getattr(self, name) < 0:
                raise InvalidError(f"{name} is {getattr(self, name)}; it must be at least 0")
        if self.generate > MAX_GENERATED:
            raise InvalidError(f"generate is {self.generate}; it must be at most {MAX_GENERATED}")
        if self.traces is None and not self.generate:
            raise InvalidError("no traces are given; give --traces DIR or --generate N")
        if not (math.isfinite(self.latency_s) and self.latency_s >= 0):
            raise InvalidError(f"latency_s is {self.latency_s}; it must be at least 0")
