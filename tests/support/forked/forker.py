"""Client of the warm process of forked_writer.py, for tests."""

from __future__ import annotations

import os
import subprocess
import sys

from codec.storage.openstorage import Target
from tests.support.commands import ROOT


class Forker:
    """The warm process, and at most one writer forked from it."""

    def __init__(self) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", "tests.support.forked.forked_writer"],
            cwd=ROOT,
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            bufsize=1,
        )

    def _ask(self, line: str) -> int:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(line + "\n")
        return int(self._process.stdout.readline())

    def start(self, target: Target) -> int:
        """Starts a writer and returns its pid; no other process can have that pid until `ended`."""
        return self._ask(str(target))

    def ended(self) -> int:
        """Waits for the end of the writer; returns its exit code."""
        return self._ask("")

    def close(self) -> None:
        self._process.communicate(timeout=60)
