"""Set before anything compiles or renders."""

from __future__ import annotations

import os

from hypothesis import settings

# Idle threads sleep instead of spinning: tests share few cores with the processes they start.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")

# A busy machine is not a failure. CI takes the same examples each time; the desk finds new ones.
settings.register_profile("desk", deadline=None)
settings.register_profile("ci", deadline=None, derandomize=True)
settings.load_profile("ci" if os.environ.get("CI") else "desk")
