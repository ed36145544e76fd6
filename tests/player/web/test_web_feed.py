"""A stream as Gaussians for other renderers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from codec.splats import SH_C0, Splats
from codec.stream.reader import StreamReader
from codec.tools.static import export_static
from player.render.recipe import ALPHA_MIN
from tests.support.hosted_streams import folder_files, write_stream
from tests.support.slots.slot_streams import write_slot_stream
from tests.support.slots.updates import small_layout
from tests.support.web.browsercode import BrowserCode

NUM_FRAMES = 17
LOOKS = [3, 4, 5, 9, 16]


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
def test_the_gaussians_are_those_of_the_package(
    browser: BrowserCode, tmp_path: Path, kind: str, first: int
) -> None:
    """The same holds if take() is called rarely, and when the stream restarts."""
    path = tmp_path / "stream"
    match kind:
        case "whole":
            write_stream(path, NUM_FRAMES, slice_size=8)
        case _:
            swin_size = int(kind.removeprefix("lanes-"))
            write_slot_stream(path, NUM_FRAMES, small_layout(swin_size, (9, 6, 5), 1, 5), seed=3)
    export_static(path, tmp_path / "static")
    found = browser.ask("fed", files=folder_files(tmp_path / "static"), first=first, looks=LOOKS)
    reader = StreamReader(path)
    for frame, seen in zip([*LOOKS, LOOKS[-1]], found, strict=True):
        expected = rows_of(reader.active_splats(frame, reader.manifest.num_layers))
        bits = bytes.fromhex("".join(seen["gaussians"]))
        rows = sorted_rows(np.frombuffer(bits, np.float32).reshape(-1, expected.shape[1]))
        np.testing.assert_array_equal(rows[:, :3], expected[:, :3])
        np.testing.assert_allclose(rows, expected, rtol=1e-5, atol=1e-6)
    # From one frame to the next, only changed Gaussians are new.
    assert found[LOOKS.index(4)]["numNew"] < reader.manifest.num_gs
