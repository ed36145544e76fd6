"""A writer: what it refuses, its resumption, failing disks, and the quality that it is told."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import count
from pathlib import Path

import numpy as np
import pytest

from codec.errors import InvalidError
from codec.slice import Slice
from codec.slots.slotlayout import Update
from codec.splats import Splats
from codec.stream import StreamReader, StreamWriter
from codec.tools.audit import verify_stream
from tests.support.drawn import same_splats
from tests.support.hostile import refused
from tests.support.slots.folder import slots_manifest
from tests.support.slots.updates import patternless_updates, small_layout
from tests.support.tiny_stream import append_tiny, files_of, tiny_manifest, tiny_slice, write_tiny

NUM_FRAMES = 10


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    path = tmp_path_factory.mktemp("writer") / "whole"
    write_tiny(path, NUM_FRAMES)
    return files_of(path)


def test_what_the_writer_refuses(tmp_path: Path) -> None:
    manifest = tiny_manifest()
    with pytest.raises(InvalidError, match="no rank is called 'size'"):
        StreamWriter.create(tmp_path / "s", manifest, rank="size")  # type: ignore[arg-type]
    writer = StreamWriter.create(tmp_path / "s", manifest)
    refused(InvalidError, "not empty", StreamWriter.create, tmp_path / "s", manifest)
    slice = tiny_slice(-2)
    double = Splats.concatenate([slice.splats, slice.splats])
    for wrong, message in (
        (tiny_slice(0), "born at 0, expected -2"),
        (Slice(-2, double, np.zeros(80, np.uint8)), "80 Gaussians, at most 40"),
        (Slice(-2, Splats.empty(1), np.zeros(0, np.uint8)), "SH degree 1, not 0"),
    ):
        refused(InvalidError, message, writer.append, wrong)
    writer.append(slice)
    writer.close()
    writer.close()
    refused(InvalidError, "closed", writer.append, tiny_slice(-1))
    assert StreamReader(tmp_path / "s").num_frames == 0
    refused(InvalidError, "finished", StreamWriter.resume, tmp_path / "s")


def test_after_a_short_segment_nothing_follows(tmp_path: Path) -> None:
    path = tmp_path / "s"
    write_tiny(path, 6)
    live = replace(StreamReader(path).manifest, live=True)
    # Killed after the last record, before the manifest was marked as finished.
    (path / "manifest.json").write_bytes(live.to_json())
    with StreamWriter.resume(path) as writer:
        assert (writer.next_birth, writer.complete) == (6, True)
        refused(InvalidError, "nothing can follow", writer.append, tiny_slice(6))
    assert not StreamReader(path).manifest.live


def too_late(birth: int) -> Slice:
    """A slice that the encoder refuses: one of its Gaussians never starts."""
    slice = tiny_slice(birth)
    return replace(slice, start_offsets=slice.start_offsets + np.uint8(3))


@pytest.mark.parametrize("goes_on", [True, False])
@pytest.mark.parametrize("birth", [-2, 0, 2, 3, 8, 9])
def test_a_slice_that_was_refused_leaves_nothing(tmp_path: Path, birth: int, goes_on: bool) -> None:
    with StreamWriter.create(tmp_path / "s", tiny_manifest()) as writer:
        append_tiny(writer, birth)
        for _ in range(2):
            with pytest.raises(InvalidError, match=r"s: update born at .*: start offset"):
                writer.append(too_late(birth))
        if goes_on:
            append_tiny(writer, NUM_FRAMES)
    assert verify_stream(tmp_path / "s").num_frames == (NUM_FRAMES if goes_on else max(birth, 0))
    if goes_on:
        write_tiny(tmp_path / "whole", NUM_FRAMES)
        assert files_of(tmp_path / "s") == files_of(tmp_path / "whole")


def test_slices_sent_whole_and_updates_may_follow_each_other(tmp_path: Path) -> None:
    manifest = tiny_manifest()
    with StreamWriter.create(tmp_path / "s", manifest, exact=True) as writer:
        for birth in range(-2, 6):
            keeping = Update.keeping(birth, manifest.slot_layout)
            writer.append(tiny_slice(birth) if birth % 4 else keeping)
    reader = StreamReader(tmp_path / "s")
    assert verify_stream(tmp_path / "s").num_frames == 6
    assert [len(reader.slice(birth, 2).splats) for birth in range(-2, 6)] == [40] * 8
    assert (reader.slice(4, 2).splats.means == reader.slice(1, 2).splats.means).all()


def test_an_exception_leaves_a_shorter_live_stream(tmp_path: Path) -> None:
    def write_and_fail() -> None:
        with StreamWriter.create(tmp_path / "s", tiny_manifest()) as writer:
            append_tiny(writer, 6)
            raise ZeroDivisionError

    refused(ZeroDivisionError, "", write_and_fail)
    summary = verify_stream(tmp_path / "s")
    assert (summary.num_frames, summary.live) == (4, True)


@pytest.mark.parametrize("kept", range(NUM_FRAMES + 3))
@pytest.mark.parametrize("swin_size", [1, 3])
def test_a_stopped_writer_goes_on(tmp_path: Path, swin_size: int, kept: int) -> None:
    layout = small_layout(swin_size, (9, 6), 0, 4)
    manifest, path = slots_manifest(layout), tmp_path / "s"
    updates = patternless_updates(layout, NUM_FRAMES)

    def write(writer: StreamWriter, stop: Callable[[StreamWriter], object], end: int) -> None:
        for update in updates[writer.next_birth - manifest.first_birth : end]:
            writer.append(update)
        stop(writer)

    write(StreamWriter.create(tmp_path / "whole", manifest), StreamWriter.close, 99)
    writer = StreamWriter.create(path, manifest)
    write(writer, StreamWriter.abort, kept)
    durable = writer.durable_birth
    (path / "segments" / "7").mkdir()
    (path / "segments" / "7" / ".0.tmp").write_bytes(b"part")
    with open(path / "index.bin", "ab") as index:
        index.write(b"part")
    writer = StreamWriter.resume(path)
    assert writer.next_birth == durable
    write(writer, StreamWriter.close, 99)
    (path / "segments" / "7").rmdir()
    assert files_of(path) == files_of(tmp_path / "whole")
    records = StreamReader(path).records
    assert writer.bytes_written == sum(sum(record.part_bytes) for record in records)
    assert writer.played_bytes == sum(record.played_bytes for record in records)


def written(path: Path, num_frames: int = 7) -> StreamWriter:
    """A writer that has written the first frames of the stream."""
    writer = StreamWriter.create(path, tiny_manifest())
    append_tiny(writer, num_frames)
    return writer


STEPS = ("fsync", "replace")


def fails(
    patch: pytest.MonkeyPatch,
    at: int,
    call: Callable[..., object],
    *arguments: object,
    names: tuple[str, ...] = STEPS,
) -> bool:
    """Whether `call` fails if step number `at` of those of the disk does, as in a power failure."""
    steps = 0

    def failing(real: Callable[..., object]) -> Callable[..., object]:
        def step(*arguments: object) -> object:
            nonlocal steps
            steps += 1
            if steps == at:
                raise OSError(28, "No space left on device")
            return real(*arguments)

        return step

    with patch.context() as context:
        for name in names:
            context.setattr(os, name, failing(getattr(os, name)))
        try:
            call(*arguments)
        except OSError:
            return True
    return False


@pytest.mark.parametrize("name", STEPS)
@pytest.mark.parametrize("again", [True, False])
def test_a_segment_whose_writing_fails_anywhere(
    tmp_path: Path, whole: dict[str, bytes], monkeypatch: pytest.MonkeyPatch, name: str, again: bool
) -> None:
    for at in count(1):
        path = tmp_path / str(at)
        writer = written(path)
        if not fails(monkeypatch, at, writer.append, tiny_slice(7), names=(name,)):
            break
        assert (writer.next_birth, writer.durable_birth) == (7, 4)
        if again:
            append_tiny(writer, NUM_FRAMES)
        writer.close()
        assert verify_stream(path).num_frames == (NUM_FRAMES if again else 7)
        assert not again or files_of(path) == whole
    assert at > 2


def test_a_close_that_failed_can_be_tried_again(
    tmp_path: Path, whole: dict[str, bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    for at in count(1):
        writer = written(tmp_path / str(at), NUM_FRAMES)
        if not fails(monkeypatch, at, writer.close):
            break
        writer.close()
        assert files_of(tmp_path / str(at)) == whole
    assert at > 5


def test_any_step(tmp_path: Path, whole: dict[str, bytes], monkeypatch: pytest.MonkeyPatch) -> None:
    for at in count(1):
        path = tmp_path / str(at)
        if not fails(monkeypatch, at, write_tiny, path, NUM_FRAMES):
            break
        if not (path / "manifest.json").exists():
            continue
        assert verify_stream(path).num_frames in (0, 4, 8, 10)
        reader = StreamReader(path)
        for record in reader.records:
            for part in reader.manifest.parts:
                name = f"segments/{record.segment}/{part}"
                assert (path / name).read_bytes() == whole[name]
        if reader.manifest.live:
            with StreamWriter.resume(path) as writer:
                append_tiny(writer, NUM_FRAMES)
        assert files_of(path) == whole
    assert at > 20


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
        refused(ZeroDivisionError, "", writer.append, tiny_slice(birth))
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
        append_tiny(writer, 0)  # nothing is scored before the first frame
        refused(InvalidError, "is not 2 numbers, each finite", writer.append, tiny_slice(0))
        assert writer.next_birth == 0
