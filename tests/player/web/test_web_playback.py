"""The browser shows the same Gaussians of a stream as the package, frame by frame, and gives them
to other renderers."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from codec.splats import SH_C0, Splats
from codec.stream.reader import StreamReader
from codec.tools.static import export_static
from player.render.project import ALPHA_MIN
from tests.support.hosted_streams import folder_files, write_stream
from tests.support.slots.slot_streams import write_slot_stream
from tests.support.slots.updates import small_layout
from tests.support.web.browsercode import BrowserCode

NUM_FRAMES = 17
LOOKS = [3, 4, 5, 9, 16]


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
    """Writes a stream of whole slices, or of so many lanes."""
    if kind == "whole":
        return write_stream(path, NUM_FRAMES, slice_size=8)
    swin_size = int(kind.removeprefix("lanes-"))
    layout = small_layout(swin_size, (6, 4, 3), swin_size % 2, 5)
    return write_slot_stream(path, NUM_FRAMES, layout, seed=swin_size)


def exported(stream: Path) -> dict[str, str]:
    """The files of a static export."""
    export_static(stream, stream.with_name("static"))
    return folder_files(stream.with_name("static"))


@pytest.mark.parametrize("kind", ["whole", "lanes-1", "lanes-2", "lanes-3"])
@pytest.mark.parametrize("first", [0, 5, 8])
def test_what_shows(browser: BrowserCode, tmp_path: Path, kind: str, first: int) -> None:
    stream = made_stream(tmp_path / "stream", kind)
    found = browser.ask("shown", files=exported(stream), first=first, lateness=0)
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
    found = browser.ask("shown", files=exported(stream), first=0, lateness=2)
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


def rows_of(splats: Splats) -> np.ndarray:
    """(N, 14 + 3 (K - 1)): mean, scales, quaternion, opacity, colour, harmonics; sorted."""
    opacities = 1 / (1 + np.exp(-splats.logit_opacities.astype(np.float64)))
    parts = (
        splats.means,
        np.exp(splats.log_scales),
        splats.quats / np.linalg.norm(splats.quats, axis=1, keepdims=True),
        opacities[:, None],
        0.5 + SH_C0 * splats.sh[:, 0],
        splats.sh[:, 1:].reshape(len(splats.means), -1),
    )
    return sorted_rows(np.hstack(parts)[opacities >= ALPHA_MIN].astype(np.float32))


def sorted_rows(rows: np.ndarray) -> np.ndarray:
    """Rows sorted by numbers that are exact: those of the mean and the harmonics."""
    keys = np.hstack([rows[:, 14:], rows[:, :3]])
    return rows[np.lexsort(keys.T)]


@pytest.mark.parametrize("kind", ["whole", "lanes-1", "lanes-3"])
@pytest.mark.parametrize("first", [0, 3])
def test_a_feed_gives_the_gaussians_of_the_package(
    browser: BrowserCode, tmp_path: Path, kind: str, first: int
) -> None:
    """The same holds if take() is called rarely, and when the stream restarts."""
    stream = made_stream(tmp_path / "stream", kind)
    found = browser.ask("fed", files=exported(stream), first=first, looks=LOOKS)
    reader = StreamReader(stream)
    for frame, seen in zip([*LOOKS, LOOKS[-1]], found, strict=True):
        expected = rows_of(reader.active_splats(frame, reader.manifest.num_layers))
        bits = bytes.fromhex("".join(seen["gaussians"]))
        rows = sorted_rows(np.frombuffer(bits, np.float32).reshape(-1, expected.shape[1]))
        np.testing.assert_array_equal(rows[:, :3], expected[:, :3])
        np.testing.assert_allclose(rows, expected, rtol=1e-5, atol=1e-6)
    # From one frame to the next, only changed Gaussians are new.
    assert found[LOOKS.index(4)]["numNew"] < reader.manifest.num_gs
