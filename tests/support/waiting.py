"""Waits for other processes and threads, and checks whether they run."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

BOUND_S = 120.0
"""Ends a hang; far beyond what any event takes on a slow machine, so no test measures by it."""


def wait_until(holds: Callable[..., object], timeout_s: float = BOUND_S) -> None:
    """Fails the test unless `holds()` becomes true in time."""
    end_s = time.monotonic() + timeout_s
    while not holds():
        assert time.monotonic() < end_s, f"still not so after {timeout_s} s"
        time.sleep(0.01)  # sleeps: between two looks at another process


def is_running(pid: int) -> bool:
    """Whether a process runs. A zombie, not yet reaped by its parent, does not run. Linux only."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False
