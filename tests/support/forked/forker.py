"""A warm process that forks stream writers for tests to kill."""

from __future__ import annotations

import os

from codec.storage.openstorage import Target
from tests.support.forked.commands import CommandServer
from tests.support.forked.commandserver import Request

WRITER = "tests.support.forked.forked_writer"


class Forker:
    """The warm process, and at most one writer forked from it."""

    def __init__(self) -> None:
        self._environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
        self._server = CommandServer(self._environment, f"{WRITER}:warm_up")

    def start(self, target: Target) -> int:
        """Starts a writer and returns its pid; no other process can have that pid until `ended`."""
        entry, words, output = f"{WRITER}:main", [str(target)], os.devnull
        return self._server.start(
            Request(entry, words, words, self._environment, os.getcwd(), output, output, {})
        )

    def ended(self) -> int:
        """Waits for the end of the writer; returns its exit code, -9 for SIGKILL."""
        return self._server.ended()

    def close(self) -> None:
        self._server.close()
