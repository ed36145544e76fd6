"""Set before anything compiles or renders."""

from __future__ import annotations

import os
import signal

from hypothesis import settings

# Idle threads sleep instead of spinning: tests share few cores with the processes they start.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")

# What runs in the background ignores Ctrl-C, and so would every process that a test starts.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
# So it is with the end of the terminal, under nohup.
if hasattr(signal, "SIGHUP") and signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:
    signal.signal(signal.SIGHUP, signal.SIG_DFL)

# A busy machine is not a failure. CI takes the same examples each time; the desk finds new ones.
settings.register_profile("desk", deadline=None)
settings.register_profile("ci", deadline=None, derandomize=True)
settings.load_profile("ci" if os.environ.get("CI") else "desk")
