"""Set before anything compiles or renders."""

from __future__ import annotations

import os
import signal

import pytest
from hypothesis import settings

# Idle threads sleep instead of spinning: tests share few cores with the processes they start.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")

# A background job ignores Ctrl-C and one started by nohup SIGHUP, and so would every process that a
# test starts.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
if hasattr(signal, "SIGHUP") and signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:
    signal.signal(signal.SIGHUP, signal.SIG_DFL)

# A busy machine is not a failure. CI takes the same examples each time; the desk finds new ones.
settings.register_profile("desk", deadline=None)
settings.register_profile("ci", deadline=None, derandomize=True)
settings.load_profile("ci" if os.environ.get("CI") else "desk")


def pytest_make_parametrize_id(config: pytest.Config, val: object, argname: str) -> str | None:
    """Bytes stand in the name of a case as their number: gzip's hold the time, so that two workers
    would not agree on it."""
    return f"{len(val)}-bytes" if isinstance(val, bytes) else None
