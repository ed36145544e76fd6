"""Updates read back from files equal the written ones."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from codec.slots.slotstate import holds
from codec.slots.update import KEPT, NEW, PREDICTED
from codec.stream import StreamReader
from codec.tools.recordedupdates import recorded_slices, recorded_update
from tests.support.drawn import same_splats
from tests.support.slots.folder import write_slots
from tests.support.slots.updates import small_layout

FRAMES = 10


@pytest.mark.parametrize("swin_size", [1, 3])
def test_updates_come_back(swin_size: int, tmp_path: Path) -> None:
    layout = small_layout(swin_size, (20, 10), 0, 4)
    written = write_slots(tmp_path, FRAMES, layout)
    assert any((update.statuses == PREDICTED).any() for update in written)
    assert any(len(update.escapes) for update in written)
    assert any(update.start_offsets.any() for update in written) == (swin_size > 1)
    births = []
    reader = StreamReader(tmp_path)
    for birth, decoder, statuses in recorded_slices(reader):
        assert decoder.frame == max(birth, 0)
        found = recorded_update(decoder, birth, statuses)
        found.check(layout)
        births.append(birth)
        if birth <= 0:
            lane = decoder.lanes[layout.lane(birth)]
            held = np.concatenate([holds(slots.conditions) for slots in lane])
            assert (statuses == np.where(held, NEW, KEPT)).all()
            continue
        update = written[len(births) - 1]
        inside = ~update.escaped
        assert (found.statuses == update.statuses).all()
        assert (found.start_offsets == update.start_offsets).all()
        assert (found.escaped == update.escaped).all()
        assert (found.states.positions[inside] == update.states.positions[inside]).all()
        assert (found.states.attributes[inside] == update.states.attributes[inside]).all()
        assert same_splats(found.escapes, update.escapes)
    assert births == list(reader.births)
