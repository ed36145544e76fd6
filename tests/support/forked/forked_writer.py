"""A warm process that forks stream writers for tests to kill.

`python -m tests.support.forked.forked_writer`. A line on its standard input is the folder or URL to
write to: the writer prints its pid before it begins, creates or resumes the stream there, and
finishes it. At an empty line the process waits for that writer and prints its exit code, -9 for
SIGKILL. A fork takes milliseconds, a new interpreter a second.
"""

from __future__ import annotations

import os
import sys
import tempfile
import traceback
from pathlib import Path

from codec.slots.update import Update
from codec.storage.openstorage import Target, open_storage, parse_target
from codec.stream import StreamWriter
from codec.stream.manifest import Manifest
from tests.support.slots.folder import slots_manifest
from tests.support.slots.updates import patternless_updates, small_layout

NUM_FRAMES = 31
"""Frames of the stream; the last segment is short."""


def forked_manifest() -> Manifest:
    """Short segments with few slots, so that the time is spent on files, not on compression."""
    return slots_manifest(small_layout(2, (5,), 0, 2))


def forked_updates() -> list[Update]:
    return patternless_updates(forked_manifest().slot_layout, NUM_FRAMES)


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


def say(number: int) -> None:
    sys.stdout.write(f"{number}\n")
    sys.stdout.flush()


def main() -> None:
    updates = forked_updates()
    with tempfile.TemporaryDirectory() as made:
        # Runs once here, so that no forked writer has to load a kernel.
        writer = StreamWriter.create(Path(made), forked_manifest())
        for update in updates[:6]:
            writer.append(update)
        writer.abort()
        write(Path(made), updates)
    pid = 0
    for line in sys.stdin:
        folder = line.rstrip("\n")
        if not folder:
            say(os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]))
            continue
        pid = os.fork()
        if not pid:
            try:
                say(os.getpid())
                write(parse_target(folder), updates)
                os._exit(0)
            except BaseException:
                traceback.print_exc()
                os._exit(1)


if __name__ == "__main__":
    main()
