"""Measures the load of this worker, for `Overload`: the CPU's, the event loop's, the network's."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable

from .overload import LoadSample

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
