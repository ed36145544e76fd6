"""The comparison of leases: slots that are coded again without prediction."""

from __future__ import annotations

from pathlib import Path

import pytest

from bench.leases import examine, recoded
from codec.slots.slotlayout import PREDICTED
from codec.stream import StreamReader
from codec.stream.manifest import SKIP_MAPS
from tests.support.slots.folder import write_slots
from tests.support.slots.updates import small_layout

FRAMES = 9


@pytest.mark.parametrize("swin_size", [1, 3])
def test_what_is_coded_again_is_the_same_but_for_the_prediction(
    swin_size: int, tmp_path: Path
) -> None:
    layout = small_layout(swin_size, (40, 20), 0, 4)
    updates = write_slots(tmp_path, FRAMES, layout)
    assert any((update.statuses == PREDICTED).any() for update in updates)
    assert any(len(update.escapes) for update in updates)
    reader = StreamReader(tmp_path)
    there = [
        [
            reader.read_object(reader.manifest.segment_of(birth), part).packet(birth)
            for part in (SKIP_MAPS, 0, 1)
        ]
        for birth in range(1, FRAMES)
    ]
    assert list(recoded(reader, predicts=True)) == there
    without = list(recoded(reader))
    assert without != there
    found = examine(reader)
    sizes = [sum(map(len, packets)) for packets in without]
    assert found["unpredicted_bytes"] == sum(sizes) / (FRAMES - 1)
    first = [(tmp_path / f"segments/0/keyframe-{n}").stat().st_size for n in (0, 1)]
    assert found["first_bytes"] == sum(first)
