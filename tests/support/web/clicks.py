"""Static exports of streams with clicks."""

from __future__ import annotations

from pathlib import Path

from codec.stream.sound import SoundSource
from codec.tools.static import export_static
from tests.support.hosted_streams import SLICE_SIZE, write_stream
from tests.support.sounding import add_clicks

CLICK_FRAMES = 15
"""Frames from click to click; the first click is at frame 0."""


def write_clicking_stream(
    folder: Path, num_frames: int, *sources: SoundSource, slice_size: int = SLICE_SIZE
) -> Path:
    """Writes a static export with clicks from each of `sources` to `folder`/static."""
    stream = write_stream(folder / "trained", num_frames, slice_size)
    for source in sources:
        add_clicks(stream, range(0, num_frames, CLICK_FRAMES), source.name, source.keys)
    export_static(stream, folder / "static")
    return folder / "static"
