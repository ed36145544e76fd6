"""Hostile bytes under a memory limit that the kernel enforces: no decoder exceeds the claim.

tests/support/bounded_decoder.py has the inputs, and the memory that each may use.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.bounded_decoder import CASES
from tests.support.commands import ROOT


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="needs Linux: VmData")
def test_memory_stays_within_what_is_declared() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "tests.support.bounded_decoder"],
        cwd=ROOT,
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    outcomes: dict[str, str] = json.loads(done.stdout)
    wrong = {
        name: outcomes[name]
        for name, case in CASES.items()
        if case.outcome not in outcomes[name]
        or (case.outcome == "value") != (outcomes[name] == "value")
    }
    assert wrong == {}
    assert len(outcomes) == len(CASES)
