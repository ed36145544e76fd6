"""A warm process that forks stream writers for tests to kill."""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path

from codec.slots.slotlayout import Update
from codec.storage.openstorage import Target, open_storage, parse_target
from codec.stream import StreamWriter
from codec.stream.manifest import Manifest
from tests.support.forked.commands import CommandServer
from tests.support.forked.commandserver import Request
from tests.support.slots.folder import slots_manifest
from tests.support.slots.updates import patternless_updates, small_layout

NUM_FRAMES = 31
"""Frames of the stream; the last segment is short."""


def forked_manifest() -> Manifest:
    """Short segments with few slots, so that the time is spent on files, not on compression."""
    return slots_manifest(small_layout(2, (5,), 0, 2))


def forked_updates() -> list[Update]:
    return patternless_updates(forked_manifest().slot_layout, NUM_FRAMES)


UPDATES = forked_updates()


def write(target: Target, updates: list[Update]) -> None:
    """Creates or resumes the stream at `target` and finishes it."""
    if open_storage(target).holds("manifest.json"):
        writer = StreamWriter.resume(target)
    else:
        writer = StreamWriter.create(target, forked_manifest())
    with writer:
        for update in updates:
            if update.birth >= writer.next_birth and not writer.complete:
                writer.append(update)


def warm_up() -> None:
    """Runs what `main` runs, so that no forked writer has to load a kernel."""
    with tempfile.TemporaryDirectory() as made:
        writer = StreamWriter.create(Path(made), forked_manifest())
        for update in UPDATES[:6]:
            writer.append(update)
        writer.abort()
        write(Path(made), UPDATES)


def main() -> None:
    write(parse_target(sys.argv[1]), UPDATES)


class Forker:
    """The warm process, and at most one writer forked from it."""

    def __init__(self) -> None:
        self._environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
        self._server = CommandServer(self._environment, f"{__name__}:warm_up")

    def start(self, target: Target) -> int:
        """Starts a writer and returns its pid; no other process can have that pid until `ended`."""
        entry, words, output = f"{__name__}:main", [str(target)], os.devnull
        return self._server.start(
            Request(entry, words, words, self._environment, os.getcwd(), output, output, {})
        )

    def ended(self) -> int:
        """Waits for the end of the writer; returns its exit code, -9 for SIGKILL."""
        return self._server.ended()

    def close(self) -> None:
        self._server.close()
