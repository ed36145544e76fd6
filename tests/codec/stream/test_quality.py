"""What a writer is told of a stream's quality stands in the index."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import pytest

from codec.slice import Slice
from codec.stream import StreamReader, StreamWriter
from tests.support.tiny_stream import SLICE_SIZE, tiny_manifest, tiny_slice

MANIFEST = tiny_manifest()  # windows of 3, segments of 4, two layers


def test_the_index_holds_the_mean_of_every_segment(tmp_path: Path) -> None:
    births = range(MANIFEST.first_birth, 6)
    seen: list[tuple[int, list[int]]] = []

    def quality(frame: int, slices: Sequence[Slice]) -> list[float] | None:
        seen.append((frame, [len(s.splats) for s in slices]))
        assert [s.birth for s in slices] == [frame, frame]
        return None if frame < 0 else [float(frame), 10.0 + frame]

    path = tmp_path / "stream"
    with StreamWriter.create(path, MANIFEST, quality=quality) as writer:
        for birth in births:
            writer.append(tiny_slice(birth))
    assert seen == [(birth, [SLICE_SIZE // 2, SLICE_SIZE]) for birth in births]
    first, last = StreamReader(path).records
    assert first.psnr_db == pytest.approx([1.5, 11.5])
    assert last.psnr_db == pytest.approx([4.5, 14.5])


def test_without_a_measure_the_quality_is_unknown(tmp_path: Path) -> None:
    with StreamWriter.create(tmp_path / "stream", MANIFEST) as writer:
        for birth in range(MANIFEST.first_birth, 2):
            writer.append(tiny_slice(birth))
    (record,) = StreamReader(tmp_path / "stream").records
    assert all(math.isnan(value) for value in record.psnr_db)
