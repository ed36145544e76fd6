"""A warm process that forks stream writers to be killed.

`python -m tests.support.forked.forked_writer`, with the argument `slots` for streams of version 2.

A line on its standard input is the folder or URL to write to: the writer says its pid when it is
about to begin, creates or resumes the stream there, and finishes it. An empty line waits for that
writer and says how it ended, -9 for SIGKILL. A fork costs milliseconds where a new interpreter
costs a second.
"""

from __future__ import annotations

import os
import sys
import tempfile
import traceback
from pathlib import Path

from codec.profiles.profile import Profile
from codec.slice import Slice
from codec.slots.update import Update
from codec.storage.openstorage import Target, open_storage, parse_target
from codec.stream import StreamWriter
from codec.stream.manifest import Manifest
from tests.support.slots.folder import slots_manifest
from tests.support.slots.updates import patternless_updates, small_layout
from tests.support.tiny_stream import tiny_manifest, tiny_slice

NUM_FRAMES = 31
"""The last segment is a short one."""


def forked_manifest(has_slots: bool = False) -> Manifest:
    """Short segments of float32, or of few slots: the time goes into files, not into
    compression."""
    if has_slots:
        return slots_manifest(small_layout(2, (5,), 0, 2))
    return tiny_manifest(Profile.RAW, swin_size=2, segment_frames=2)


def forked_slices(has_slots: bool = False) -> list[Slice] | list[Update]:
    manifest = forked_manifest(has_slots)
    if has_slots:
        return patternless_updates(manifest.slot_layout, NUM_FRAMES)
    return [tiny_slice(birth) for birth in range(manifest.first_birth, NUM_FRAMES)]


def write(target: Target, slices: list[Slice] | list[Update]) -> None:
    """Creates or resumes the stream at `target` and finishes it."""
    if open_storage(target).holds("manifest.json"):
        writer = StreamWriter.resume(target)
    else:
        writer = StreamWriter.create(target, forked_manifest(isinstance(slices[0], Update)))
    with writer:
        for slice in slices:
            if slice.birth >= writer.next_birth and not writer.complete:
                writer.append(slice)


def say(number: int) -> None:
    sys.stdout.write(f"{number}\n")
    sys.stdout.flush()


def main() -> None:
    slices = forked_slices("slots" in sys.argv[1:])
    with tempfile.TemporaryDirectory() as made:
        # Here once, so that no writer that is forked has to load a kernel.
        writer = StreamWriter.create(Path(made), forked_manifest(isinstance(slices[0], Update)))
        for slice in slices[:6]:
            writer.append(slice)
        writer.abort()
        write(Path(made), slices)
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
                write(parse_target(folder), slices)
                os._exit(0)
            except BaseException:
                traceback.print_exc()
                os._exit(1)


if __name__ == "__main__":
    main()
