"""Frames of streams as files: nothing hidden is exported."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from codec.interop.exporting import export_stream
from codec.interop.formats import SplatFormat, read_splats
from codec.splats import Splats
from tests.goldens.decoder import Gaussian, to_floats
from tests.goldens.folder import StreamFolder, state_at
from tests.support.slots.folder import write_slots
from tests.support.slots.updates import small_layout

LAYOUT = small_layout(3, (9, 6), 1, 4)


def by_position(splats: Splats) -> Splats:
    return splats.take(np.lexsort(splats.means.T))


@pytest.mark.parametrize("layers", [1, 2])
def test_what_shows_is_exported_and_nothing_else(layers: int, tmp_path: Path) -> None:
    """Compared with the plain decoder: Gaussians that have started, and no empty slot."""
    write_slots(tmp_path / "s", 10, LAYOUT)
    hidden = 0
    for frame in range(10):
        shape = StreamFolder(tmp_path / "s").shape
        held = [
            (slot, lattice)
            for lane in state_at(tmp_path / "s", frame, layers)
            for row, lattice in zip(lane[:layers], shape.lattice[:layers], strict=True)
            for slot in row
        ]
        shown = [
            to_floats(slot, lattice)
            for slot, lattice in held
            if isinstance(slot, Gaussian) and slot.start <= frame
        ]
        hidden += len(held) - len(shown)
        means = np.array([floats.mean for floats in shown], np.float32).reshape(-1, 3)
        for format in SplatFormat:
            [out] = export_stream(
                tmp_path / "s", tmp_path / f"o.{format}", frame, None, None, layers
            )
            found = read_splats(out)
            assert len(found) == len(shown)
            if format is SplatFormat.PLY:
                assert (by_position(found).means == means[np.lexsort(means.T)]).all()
                assert np.isfinite(found.logit_opacities).all()
    assert hidden > 20
