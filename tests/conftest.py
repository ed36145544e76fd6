"""Set before anything compiles or renders."""

from __future__ import annotations

import os

# Idle threads sleep instead of spinning: tests share few cores with the processes they start.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")
