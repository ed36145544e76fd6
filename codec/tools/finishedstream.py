"""The stream in a folder that sound or captions are added to."""

from __future__ import annotations

from pathlib import Path

from codec.errors import InvalidError
from codec.stream.packedlayout import PACKED_SUFFIX
from codec.stream.reader import StreamReader


def finished(stream: Path) -> StreamReader:
    """The stream in the folder `stream`, if it may be changed. Raises a SwingsError."""
    if stream.name.endswith(PACKED_SUFFIX) and not stream.is_dir():
        raise InvalidError(f"{stream} is one file; unpack it first: swings-stream unpack")
    reader = StreamReader(stream, max_gaussians=None)
    if reader.manifest.live or not reader.records:
        raise InvalidError(f"{stream} is live or has no frames; add to it when it is finished")
    return reader
