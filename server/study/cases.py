"""A trace at a load: the link of one case, over which every policy plays.

The load is what the link carries over what the stream needs with all layers. The trace is scaled
to it, so that a stream meets links that are too slow, just right and fast whatever its bitrate is.
What counts is the mean rate of the trace where a play uses it: its first LOAD_WINDOW lengths of the
play, for with its stalls a play takes longer than it shows. Of a trace of ten minutes the mean says
little about the minute that is played.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from codec.errors import InvalidError
from server.abr.link.link import Link
from server.abr.link.traces import scaled

from .looped import LoopedMedia
from .tracefolder import Trace

LOAD_WINDOW = 1.5
"""Lengths of the play over which the mean rate of a trace is taken."""
LOADS = (0.6, 1.0, 1.8)
"""Layer 0 and a little, nearly all layers, and more than all of them."""
LEAST_LOAD, MOST_LOAD = 0.05, 100.0


@dataclass(frozen=True, slots=True)
class Case:
    """One trace at one load."""

    trace: str
    load: float
    link: Link


def at_load(trace: Trace, load: float, media: LoopedMedia) -> Case:
    """The case of `trace` at `load`. Raises InvalidError where nothing passes in time."""
    if not LEAST_LOAD <= load <= MOST_LOAD:
        raise InvalidError(f"load is {load:g}; it must be {LEAST_LOAD:g} to {MOST_LOAD:g}")
    window_s = min(trace.link.round_s, LOAD_WINDOW * media.length_s)
    mean_bps = 8 * trace.link.capacity_bytes(0.0, window_s) / window_s
    factor = load * media.need_bps / mean_bps if mean_bps else math.inf
    if not math.isfinite(factor):
        raise InvalidError(
            f"trace {trace.name}: no data passes in its first {window_s:g} s; leave it out"
        )
    return Case(trace.name, load, scaled(trace.link, factor))


def make_cases(traces: Sequence[Trace], loads: Sequence[float], media: LoopedMedia) -> list[Case]:
    """All traces at the first load, then at the next."""
    return [at_load(trace, load, media) for load in loads for trace in traces]
