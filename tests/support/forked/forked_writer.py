"""A warm process that forks stream writers to be killed.

`python -m tests.support.forked.forked_writer`. A line on its standard input is the folder or URL to
write to: the writer says its pid when it is about to begin, creates or resumes the stream there,
and finishes it. An empty line waits for that writer and says how it ended, -9 for SIGKILL. A fork
costs milliseconds where a new interpreter costs a second.
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
"""The last segment is a short one."""


def forked_manifest() -> Manifest:
    """Short segments of few slots: the time goes into files, not into compression."""
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
        # Here once, so that no writer that is forked has to load a kernel.
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
