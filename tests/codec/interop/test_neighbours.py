"""Streams as sequences of other programs, and back."""

from __future__ import annotations

import contextlib
import importlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from codec.errors import InvalidError
from codec.interop import splat4dexport
from codec.interop.formats import SplatFormat, write_splats
from codec.interop.sequences import SequenceFormat
from codec.sequence.importing import ImportOptions, import_stream
from codec.stream import StreamReader
from codec.tools.audit import verify_stream
from tests.support.alike import largest_errors
from tests.support.commands import run_ok
from tests.support.slots.rotating import figure, turned

fourdgs: Any = None
with contextlib.suppress(ImportError):
    fourdgs = importlib.import_module("fourdgs.keyframe_delta_file")
PROGRAM: str | None = None
with contextlib.suppress(InvalidError):
    PROGRAM = splat4dexport.find_program()

needs_fourdgs = pytest.mark.skipif(fourdgs is None, reason="fourdgs is missing: scripts/setup dev")
needs_splat4d = pytest.mark.skipif(PROGRAM is None, reason="splats4d is missing: scripts/setup dev")

FPS, FIGURE = 25.0, figure(436)


FRAMES = [turned(FIGURE.take(np.arange(6 * n, 6 * n + 400)), 0.03 * n) for n in range(7)]
"""A turning figure, in which Gaussians are replaced."""


@needs_fourdgs
@needs_splat4d
@pytest.mark.parametrize("format", list(SequenceFormat))
def test_a_stream_there_and_back(format: SequenceFormat, tmp_path: Path) -> None:
    (tmp_path / "files").mkdir()
    for number, splats in enumerate(FRAMES):
        write_splats(tmp_path / "files" / f"{number}.ply", splats, SplatFormat.PLY)
    import_stream(tmp_path / "files", tmp_path / "stream", ImportOptions(fps=FPS))
    run_ok("swings-stream", "export", tmp_path / "stream", tmp_path / f"all.{format}")
    import_stream(tmp_path / f"all.{format}", tmp_path / "back", ImportOptions())
    assert verify_stream(tmp_path / "back").num_frames == len(FRAMES)
    before, after = (StreamReader(tmp_path / name) for name in ("stream", "back"))
    assert after.manifest.fps == FPS
    for frame in range(len(FRAMES)):
        a, b = (reader.active_splats(frame, 4) for reader in (before, after))
        assert (largest_errors(b, a) < (1.5, 0.2, 0.15, 0.03, 0.06)).all()
