"""What a user can set for swings-abr; every default stands here once."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from codec.console import option
from codec.errors import InvalidError
from server.abr.link.generate import GeneratorConfig
from server.abr.link.ratetext import RATE_PATTERN, rate_bps
from server.abr.policies.choice import POLICIES
from server.abr.qoe import QoeConfig
from server.abr.session import SessionConfig

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
                f"policy {name!r} is not known; there are {', '.join(POLICIES)}, and all"
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
    """What to play over what, and where the report goes."""

    stream: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="STREAM")]]
    """Folder of a stream; only its manifest and index are read."""
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")]
    """Folder of the report, absent or empty."""
    traces: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """Folder of throughput traces, searched through: JSON as Sabre's, or Mahimahi's text."""
    generate: int = 0
    """Made-up traces, besides those of the folder or in their place."""
    policies: Annotated[tuple[str, ...], POLICY_NAMES] = tuple(POLICIES)
    """Policies to compare, with commas between them."""
    loads: tuple[float, ...] = LOADS
    """What the links carry over what the stream needs with all layers: the mean rate of each trace
    is scaled to these."""
    half: Half = "all"
    """Which traces: tune for the first, third, ... of each folder, by name; report for the
    others."""
    per_folder: int = 0
    """Traces of each folder at most, evenly spread; 0 for all."""
    length_s: Annotated[float, tyro.conf.arg(name="length")] = 60.0
    """Seconds of each play; a shorter stream is repeated."""
    as_bitrate: Annotated[float | None, BITRATE] = None
    """What the stream shall need with all layers, its sizes scaled, such as 36M."""
    timeline: Annotated[str, tyro.conf.arg(metavar="TRACE@LOAD")] = ""
    """The case that is drawn over time; else one in the middle."""
    seed: int = 0
    """Of made-up traces and of the bootstrap."""
    jobs: int = 0
    """Processes that play; 0 for one on each core. The report does not depend on it."""
    latency_s: float = 0.02
    """Latency of traces that say none, as Mahimahi's, seconds."""
    session: SessionConfig = field(default_factory=SessionConfig)
    """Pacing of plays."""
    qoe: QoeConfig = field(default_factory=QoeConfig)
    """What waiting and unrest cost."""
    generator: GeneratorConfig = field(default_factory=GeneratorConfig)
    """What made-up traces are like."""

    def __post_init__(self) -> None:
        if not self.loads or len(set(self.loads)) < len(self.loads):
            raise InvalidError(f"loads are {self.loads}; give one or more, each once")
        if not 0 < self.length_s <= MAX_LENGTH_S:
            raise InvalidError(f"length is {self.length_s}; it must be over 0, to {MAX_LENGTH_S:g}")
        for name in ("generate", "per_folder", "seed", "jobs"):
            if getattr(self, name) < 0:
                raise InvalidError(f"{name} is {getattr(self, name)}; it must be at least 0")
        if self.generate > MAX_GENERATED:
            raise InvalidError(f"generate is {self.generate}; it must be at most {MAX_GENERATED}")
        if self.traces is None and not self.generate:
            raise InvalidError("there is nothing to play over; give --traces DIR or --generate N")
        if not (math.isfinite(self.latency_s) and self.latency_s >= 0):
            raise InvalidError(f"latency_s is {self.latency_s}; it must be at least 0")
