"""What a writer is told of a stream's quality stands in the index."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import pytest

from codec.stream import StreamReader, StreamWriter
from codec.stream.chunk import Chunk
from tests.support.running_server import (
    SEGMENT_FRAMES,
    SWIN_SIZE,
    births_of,
    random_slice,
    small_manifest,
)


def test_the_index_holds_the_mean_of_every_segment(tmp_path: Path) -> None:
    seen: list[tuple[int, int]] = []

    def quality(chunks: Sequence[Chunk]) -> list[float] | None:
        seen.append((chunks[0].birth, sum(len(c.slice.splats) for c in chunks)))
        assert [c.layer for c in chunks] == [0, 1, 2, 3]
        frame = chunks[0].birth
        return None if frame < 0 else [10.0 * layer + frame for layer in range(4)]

    path = tmp_path / "stream"
    with StreamWriter.create(path, small_manifest(), quality=quality) as writer:
        for birth in births_of(SEGMENT_FRAMES + 2):
            writer.append(random_slice(birth, 8))
    assert seen == [(birth, 8) for birth in range(1 - SWIN_SIZE, SEGMENT_FRAMES + 2)]
    first, last = StreamReader(path).records
    middle = (SEGMENT_FRAMES - 1) / 2
    assert first.psnr_db == pytest.approx([middle, 10 + middle, 20 + middle, 30 + middle])
    assert last.psnr_db[0] == pytest.approx(SEGMENT_FRAMES + 0.5)


def test_without_a_measure_the_quality_is_unknown(tmp_path: Path) -> None:
    with StreamWriter.create(tmp_path / "stream", small_manifest()) as writer:
        for birth in births_of(2):
            writer.append(random_slice(birth, 8))
    (record,) = StreamReader(tmp_path / "stream").records
    assert all(math.isnan(value) for value in record.psnr_db)
