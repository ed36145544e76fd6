"""scripts/bench parts finds and kills its own processes, and no others."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from bench.parts import WORKER, Killer, peak_bytes, processes
from tests.support.waiting import BOUND_S, wait_until

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="/proc is Linux's")


def test_processes_are_those_that_this_one_has_started() -> None:
    waits = "import sys; sys.stdin.read()"
    with subprocess.Popen([sys.executable, "-c", waits, WORKER], stdin=subprocess.PIPE) as child:
        wait_until(lambda: child.pid in processes(WORKER))
        wait_until(lambda: peak_bytes(child.pid) > 1_000_000)  # an interpreter that has started
        assert os.getppid() not in processes(b"")
        assert os.getpid() in processes(b"")
        killer = Killer(1, 0.0, 1)
        killer.look()
        child.wait(timeout=BOUND_S)
        killer.look()
        assert killer.killed == 1
    assert peak_bytes(child.pid) == 0
