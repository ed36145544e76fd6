"""The quality of a stream that a writer receives is in the index."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import pytest

from codec.errors import InvalidError
from codec.slice import Slice
from codec.stream import StreamReader, StreamWriter
from tests.support.drawn import same_splats
from tests.support.slots.folder import slots_manifest
from tests.support.slots.updates import patternless_updates
from tests.support.tiny_stream import SLICE_SIZE, append_tiny, tiny_manifest, tiny_slice, write_tiny

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
    write_tiny(tmp_path / "plain", 2)
    (record,) = StreamReader(tmp_path / "plain").records
    assert all(math.isnan(value) for value in record.psnr_db)
    first, last = StreamReader(path).records
    assert first.psnr_db == pytest.approx([1.5, 11.5])
    assert last.psnr_db == pytest.approx([4.5, 14.5])


def test_it_is_asked_once_for_every_slice_as_a_reader_has_it(tmp_path: Path) -> None:
    told: list[tuple[int, list[Slice]]] = []

    def quality(birth: int, slices: Sequence[Slice]) -> None:
        told.append((birth, list(slices)))

    path, updates = tmp_path / "s", patternless_updates(slots_manifest().slot_layout, 10)
    with StreamWriter.create(path, slots_manifest(), quality=quality) as writer:
        for update in updates[:9]:
            writer.append(update)
        writer.abort()
    with StreamWriter.resume(path, quality=quality) as writer:
        for update in updates[writer.next_birth + 2 :]:
            writer.append(update)
    assert [birth for birth, _ in told] == [*range(-2, 7), *range(4, 10)]
    reader = StreamReader(path)
    for birth, slices in told:
        for layers, found in enumerate(slices, start=1):
            wanted = reader.slice(birth, layers)
            assert found.birth == wanted.birth
            assert (found.start_offsets == wanted.start_offsets).all()
            assert same_splats(found.splats, wanted.splats)


@pytest.mark.parametrize("birth", [1, 3, 9])
def test_a_quality_that_raises_leaves_nothing(tmp_path: Path, birth: int) -> None:
    fail = True

    def quality(frame: int, slices: Sequence[Slice]) -> list[float] | None:
        if fail and frame == birth:
            raise ZeroDivisionError
        return [20.0 + frame, 30.0] if frame >= 0 else None

    path = tmp_path / "s"
    with StreamWriter.create(path, tiny_manifest(), quality=quality) as writer:
        append_tiny(writer, birth)
        with pytest.raises(ZeroDivisionError):
            writer.append(tiny_slice(birth))
        fail = False
        append_tiny(writer, 10)
    scores_db = [record.psnr_db for record in StreamReader(path).records]
    assert scores_db == [(21.5, 30.0), (25.5, 30.0), (28.5, 30.0)]
    write_tiny(tmp_path / "whole", 10)
    for name in ("manifest.json", *(str(p.relative_to(path)) for p in path.glob("segments/*/*"))):
        assert (path / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()


@pytest.mark.parametrize("scores", [(30.0, math.inf), (30.0,), (30.0, 31.0, 32.0)])
def test_a_quality_that_the_index_cannot_hold(tmp_path: Path, scores: tuple[float, ...]) -> None:
    with StreamWriter.create(
        tmp_path / "s", tiny_manifest(), quality=lambda frame, slices: scores
    ) as writer:
        for birth in (-2, -1):  # nothing is scored before the first frame
            writer.append(tiny_slice(birth))
        with pytest.raises(InvalidError, match="is not 2 numbers, each finite"):
            writer.append(tiny_slice(0))
        assert writer.next_birth == 0
