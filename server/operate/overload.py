"""The ladder of a worker under load: fewer layers first, then no new plays.

Rule: the ladder has no clock. What was measured comes in with its time (at the end of this file is
what measures); a sample of more load never gives a client more, and load that is gone is forgotten.
"""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Callable
from dataclasses import dataclass

from codec.console import Constant
from codec.errors import InvalidError

MAX_LOAD = 1.25
"""Upper limit of the load of one sample, so that recovery is fast."""

MAX_SAMPLE_S = 1.0
"""Seconds that one sample speaks for at most: a worker that slept knows little of the time."""


@dataclass(frozen=True, slots=True)
class OverloadConfig:
    """Thresholds and recovery of load shedding in a worker."""

    shed_from: float = 0.8
    """Load from which plays get fewer layers; 1 is the full capacity of one core. No load is above
    1.25: from 2 on, plays never do."""
    refuse_from: float = 0.95
    """Load from which plays get one layer and new plays are answered with 503."""
    recover_margin: Constant[float] = 0.05
    """How far the average load must fall below the effective load before plays get more layers."""
    recover_per_s: Constant[float] = 0.05
    """Decrease of the effective load per second during recovery."""
    smooth_s: Constant[float] = 1.0
    """Time constant of the average load, in seconds."""
    max_late_s: Constant[float] = 0.2
    """Event-loop lateness that counts as a load of 1, in seconds."""
    max_egress_bps: float = 0.0
    """Maximum bits per second over all connections of a worker; 0 for no limit."""

    def __post_init__(self) -> None:
        if not 0 < self.shed_from < self.refuse_from:
            raise InvalidError(
                f"shed_from is {self.shed_from} and refuse_from {self.refuse_from}; "
                "give 0 < shed_from < refuse_from"
            )
        if not 0 <= self.recover_margin < self.shed_from:
            raise InvalidError(
                f"recover_margin is {self.recover_margin}; give 0 or more, below shed_from"
            )
        for name in ("recover_per_s", "smooth_s", "max_late_s"):
            if not 0 < getattr(self, name) < math.inf:
                raise InvalidError(f"{name} is {getattr(self, name)}; it must be positive")
        if not 0 <= self.max_egress_bps < math.inf:
            raise InvalidError(f"max_egress_bps is {self.max_egress_bps}; give 0 or more")


@dataclass(frozen=True, slots=True)
class LoadSample:
    """Measurements of a worker since the last sample."""

    time_s: float
    """When it was taken."""
    busy_share: float = 0.0
    """CPU seconds of the process in a second."""
    late_s: float = 0.0
    """How late the event loop was."""
    egress_bps: float = 0.0
    """Bits sent in a second."""


class Overload:
    """A worker's load, and the layers and plays that it allows."""

    def __init__(self, config: OverloadConfig, max_plays: int) -> None:
        """max_plays: plays that run at the same time at most. Their number sheds no layers: as
        long as the machine is idle, the last of them gets what the first got."""
        self._config = config
        self._max_plays = max_plays
        self._time_s: float | None = None
        self._smooth = 0.0
        self.load = 0.0
        """The load that is acted on: up with the average, down slowly."""

    def observe(self, sample: LoadSample) -> None:
        """Takes in one sample; those of an earlier time than the last one are passed over."""
        config = self._config
        last_s = sample.time_s if self._time_s is None else self._time_s
        if sample.time_s < last_s:
            return
        self._time_s = sample.time_s
        seconds = min(sample.time_s - last_s, MAX_SAMPLE_S)
        measured = max(sample.busy_share, sample.late_s / config.max_late_s)
        if config.max_egress_bps:
            measured = max(measured, sample.egress_bps / config.max_egress_bps)
        share = -math.expm1(-seconds / config.smooth_s)
        self._smooth += share * (min(max(measured, 0.0), MAX_LOAD) - self._smooth)
        recovered = self.load - config.recover_per_s * seconds
        kept = min(self.load, max(self._smooth + config.recover_margin, recovered))
        self.load = max(self._smooth, kept)

    def max_layers(self, num_layers: int) -> int:
        """How many of `num_layers` a play may take in: all below shed_from, 1 at refuse_from."""
        config = self._config
        room = (config.refuse_from - self.load) / (config.refuse_from - config.shed_from)
        return max(1, min(num_layers, 1 + math.floor(num_layers * room)))

    def accepts_plays(self, num_plays: int, continues: bool = False) -> bool:
        """Whether one more play may begin while `num_plays` run. continues: whether it continues a
        play that lost its connection or worker. That play was part of the load before, and its
        viewer's picture stands still until it continues."""
        has_time = continues or self.load < self._config.refuse_from
        return has_time and num_plays < self._max_plays

    @property
    def retry_after_s(self) -> int:
        """Whole seconds after which a refused client may try again."""
        config = self._config
        return 2 + math.ceil(max(0.0, self.load - config.refuse_from) / config.recover_per_s)


EVERY_S = 0.25
"""Seconds between two samples."""

LAG_EVERY_S = 0.02
"""Seconds between two looks at how late the event loop is."""


async def measure_lag(late: Callable[[float], None]) -> None:
    """Calls `late` with the seconds that the event loop is late, again and again, until it is
    cancelled."""
    clock = asyncio.get_running_loop().time
    while True:
        began_s = clock()
        await asyncio.sleep(LAG_EVERY_S)
        late(clock() - began_s - LAG_EVERY_S)


async def measure_load(
    observe: Callable[[LoadSample], None],
    sent_bytes: Callable[[], int],
    every_s: float = EVERY_S,
) -> None:
    """Calls `observe` every `every_s` seconds, until it is cancelled.

    sent_bytes: bytes that were sent since the worker began.
    """
    loop = asyncio.get_running_loop()
    last_s, last_cpu_s, last_bytes = loop.time(), time.process_time(), sent_bytes()
    while True:
        await asyncio.sleep(every_s)
        now_s, cpu_s, num_bytes = loop.time(), time.process_time(), sent_bytes()
        seconds = max(now_s - last_s, 1e-6)
        sample = LoadSample(
            now_s,
            busy_share=(cpu_s - last_cpu_s) / seconds,
            late_s=max(0.0, seconds - every_s),
            egress_bps=8 * (num_bytes - last_bytes) / seconds,
        )
        last_s, last_cpu_s, last_bytes = now_s, cpu_s, num_bytes
        observe(sample)
