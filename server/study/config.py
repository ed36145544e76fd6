"""The settings of swings-abr; every default is defined here once."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, ClassVar

import tyro

from codec.console import option
from codec.errors import InvalidError
from codec.helptext import Groups
from server.abr.session import SessionConfig

from .choice import POLICIES, check_policy, short_name
from .generate import GeneratorConfig
from .qoe import QoeConfig
from .tracefolder import Half

LOADS = (0.6, 1.0, 1.8)
"""Layer 0 and a little, nearly all layers, and more than all of them."""
MAX_LENGTH_S = 3600.0
MAX_GENERATED = 10_000


def parse_policies(text: str) -> tuple[str, ...]:
    """Policies with commas between them, `all` for those that come along; see `make_policy`.
    Raises InvalidError."""
    found: dict[str, str] = {}
    for word in text.split(","):
        for policy in POLICIES if word == "all" else [check_policy(word)]:
            if found.setdefault(short_name(policy), policy) != policy:
                raise InvalidError(f"two policies are named {short_name(policy)}; rename one")
    return tuple(found.values())


POLICIES_OPTION = option("all|A,FILE.py:NAME,...", parse_policies, ",".join)


@dataclass(frozen=True, slots=True)
class Rules:
    """Settings shared by all plays."""

    session: SessionConfig = field(default_factory=SessionConfig)
    qoe: QoeConfig = field(default_factory=QoeConfig)


@dataclass(frozen=True, slots=True)
class StudyConfig:
    """The plays to simulate."""

    EVERYDAY: ClassVar[Groups] = {
        "Policies": ("policy", "out"),
        "Links": ("traces", "generate", "loads", "half", "per-folder", "latency-s"),
        "Plays": ("length", "jobs", "seed"),
    }

    stream: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="STREAM")]]
    """Folder of a stream; only its manifest and index are read."""
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """Folder for plays.csv and plays.png; it must be absent or empty."""
    traces: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """Folder of throughput traces, and its subfolders: JSON as in Sabre, or text as in Mahimahi."""
    generate: int = 0
    """Number of generated traces, in addition to those of the folder or instead of them."""
    policy: Annotated[tuple[str, ...], POLICIES_OPTION] = tuple(POLICIES)
    """Policies to compare, separated by commas; FILE.py:NAME for one of your own, see
    docs/EXTENDING.md."""
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
    seed: int = 0
    """Seed of the generated traces."""
    jobs: int = 0
    """Worker processes; 0 for one per core. The results do not depend on their number."""
    latency_s: float = 0.02
    """Latency of traces without one, such as Mahimahi's, seconds."""
    session: SessionConfig = field(default_factory=SessionConfig)
    """Pacing of plays."""
    qoe: QoeConfig = field(default_factory=QoeConfig)
    """Costs of waiting and of quality changes."""
    generator: GeneratorConfig = field(default_factory=GeneratorConfig)
    """Properties of the generated traces."""

    @property
    def rules(self) -> Rules:
        return Rules(self.session, self.qoe)

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
