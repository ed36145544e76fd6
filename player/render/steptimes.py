"""How long a renderer takes for each step of a picture."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass


@dataclass(slots=True)
class StepTimes:
    """Time of each step when it ran last, until it was finished, milliseconds."""

    upload_ms: float = 0.0
    """New slices to where they are drawn from; 0 where there was none."""
    sort_ms: float = 0.0
    """Which Gaussians show, and their order; on the CPU also where on the picture."""
    draw_ms: float = 0.0
    """Blending."""


@contextmanager
def step(times: StepTimes | None, name: str, finish: Callable[[], object]) -> Iterator[None]:
    """Notes what the block took as `name`; without `times` nothing is waited for.

    finish: waits for what the block only asked for.
    """
    if times is None:
        yield
        return
    began_s = time.perf_counter()
    yield
    finish()
    setattr(times, name, (time.perf_counter() - began_s) * 1000)
