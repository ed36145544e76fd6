"""Appends noise to a new stream in real time: `python livewriter.py FOLDER GAUSSIANS SECONDS`.

Prints one line of JSON for each segment: its first birth, one past its last birth, and the time of
its index record. That time is the index file's last change: a server can read the record from then
on, although the writer still waits for the disk.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

from bench.serve.material import FPS, noise_manifest, noise_slice
from codec.stream import StreamWriter
from codec.stream.segment import INDEX_NAME

SEGMENT_FRAMES = 5
LEAD_FRAMES = 30
"""Frames that are written at the start."""


def main() -> None:
    path, slice_size, seconds = Path(sys.argv[1]), int(sys.argv[2]), float(sys.argv[3])
    manifest = noise_manifest(slice_size, SEGMENT_FRAMES, live=True)
    num_frames = LEAD_FRAMES + round(seconds * FPS)
    slices = [noise_slice(birth, slice_size) for birth in range(num_frames)]
    began_s = None
    with StreamWriter.create(path, manifest, exact=True) as writer:
        for birth, one in enumerate(slices):
            if birth >= LEAD_FRAMES:
                began_s = time.monotonic() if began_s is None else began_s
                due_s = began_s + (birth - LEAD_FRAMES) / FPS
                time.sleep(max(0.0, due_s - time.monotonic()))
            before = writer.durable_birth
            writer.append(one)
            if writer.durable_birth > before:
                at_s = (path / INDEX_NAME).stat().st_mtime_ns / 1e9
                told = {"birth": before, "end_birth": writer.durable_birth, "at_s": at_s}
                print(json.dumps(told), flush=True)


if __name__ == "__main__":
    main()
