"""The browser shows the same Gaussians of a stream as the package, frame by frame."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from codec.stream.reader import StreamReader
from codec.tools.static import export_static
from player.render.recipe import ALPHA_MIN
from tests.support.hosted_streams import folder_files, write_stream
from tests.support.slots.slot_streams import write_slot_stream
from tests.support.slots.updates import small_layout
from tests.support.web.browsercode import BrowserCode

NUM_FRAMES = 17


def shown_by_package(stream: Path, frame: int) -> list[str]:
    """Means of the shown Gaussians, farthest first for the default camera."""
    reader = StreamReader(stream)
    manifest = reader.manifest
    splats = reader.active_splats(frame, manifest.num_layers)
    opacities = 1 / (1 + np.exp(-splats.logit_opacities))
    _, _, depths = manifest.camera().project(splats.means)
    shows = np.flatnonzero((opacities >= ALPHA_MIN) & (depths > manifest.near_m))
    order = shows[np.argsort(-depths[shows], kind="stable")]
    return [mean.tobytes().hex() for mean in splats.means[order]]


def made_stream(path: Path, kind: str) -> Path:
    match kind:
        case "whole":
            return write_stream(path, NUM_FRAMES, slice_size=8)
        case _:
            swin_size = int(kind.removeprefix("lanes-"))
            layout = small_layout(swin_size, (6, 4, 3), swin_size % 2, 5)
            return write_slot_stream(path, NUM_FRAMES, layout, seed=swin_size)


@pytest.mark.parametrize("kind", ["whole", "lanes-1", "lanes-2", "lanes-3"])
@pytest.mark.parametrize("first", [0, 5, 8])
def test_what_shows(browser: BrowserCode, tmp_path: Path, kind: str, first: int) -> None:
    stream = made_stream(tmp_path / "stream", kind)
    export_static(stream, tmp_path / "static")
    files = folder_files(tmp_path / "static")
    found = browser.ask("shown", files=files, first=first, lateness=0)
    assert len(found) == NUM_FRAMES - first
    for frame, means in enumerate(found, first):
        expected = shown_by_package(stream, frame)
        assert Counter(means) == Counter(expected)
        assert_far_first(stream, means)


def assert_far_first(stream: Path, means_hex: list[str]) -> None:
    means = np.frombuffer(bytes.fromhex("".join(means_hex)), np.float32).reshape(-1, 3)
    _, _, depths = StreamReader(stream).manifest.camera().project(means.astype(np.float64))
    assert (np.diff(depths) < 1e-5).all()


@pytest.mark.parametrize("kind", ["whole", "lanes-1", "lanes-2"])
def test_layers_that_come_late_are_shown_soon(
    browser: BrowserCode, tmp_path: Path, kind: str
) -> None:
    stream = made_stream(tmp_path / "stream", kind)
    export_static(stream, tmp_path / "static")
    files = folder_files(tmp_path / "static")
    found = browser.ask("shown", files=files, first=0, lateness=2)
    reader = StreamReader(stream)
    segment_frames, swin_size = reader.manifest.segment_frames, reader.manifest.swin_size
    complete = 0
    for frame, means in enumerate(found):
        expected = Counter(shown_by_package(stream, frame))
        assert not Counter(means) - expected
        into = frame % segment_frames
        if into >= 2 + swin_size:
            assert Counter(means) == expected
            complete += 1
    assert complete > 2 or kind == "whole"
