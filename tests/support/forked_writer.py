"""A warm process that forks stream writers to be killed: `python -m tests.support.forked_writer`.

A line on its standard input is the folder to write to: the writer says its pid when it is about to
begin, creates or resumes the stream there, and finishes it. An empty line waits for that writer and
says how it ended, -9 for SIGKILL. A fork costs milliseconds where a new interpreter costs a second.
"""

from __future__ import annotations

import os
import sys
import traceback
from pathlib import Path

from codec.profiles.profile import Profile
from codec.slice import Slice
from codec.stream import StreamWriter
from codec.stream.manifest import Manifest
from tests.support.tiny_stream import tiny_manifest, tiny_slice

NUM_FRAMES = 31
"""The last segment is a short one."""


def forked_manifest() -> Manifest:
    """Short segments of float32: the time goes into files, not into compression."""
    return tiny_manifest(Profile.RAW, swin_size=2, segment_frames=2)


def forked_slices() -> list[Slice]:
    return [tiny_slice(birth) for birth in range(forked_manifest().first_birth, NUM_FRAMES)]


def write(path: Path, slices: list[Slice]) -> None:
    """Creates or resumes the stream at `path` and finishes it."""
    if (path / "manifest.json").exists():
        writer = StreamWriter.resume(path)
    else:
        writer = StreamWriter.create(path, forked_manifest())
    with writer:
        for slice in slices:
            if slice.birth >= writer.next_birth and not writer.complete:
                writer.append(slice)


def say(number: int) -> None:
    sys.stdout.write(f"{number}\n")
    sys.stdout.flush()


def main() -> None:
    slices = forked_slices()
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
                write(Path(folder), slices)
                os._exit(0)
            except BaseException:
                traceback.print_exc()
                os._exit(1)


if __name__ == "__main__":
    main()
