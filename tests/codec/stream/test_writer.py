"""Slices that a writer refuses, and its resumption after a stop."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from codec.errors import InvalidError
from codec.slice import Slice
from codec.slots.update import Update
from codec.splats import Splats
from codec.stream import StreamReader, StreamWriter
from codec.tools.audit import verify_stream
from tests.support.slots.folder import slots_manifest, write_slots
from tests.support.slots.updates import patternless_updates
from tests.support.tiny_stream import (
    append_tiny,
    files_of,
    tiny_manifest,
    tiny_slice,
    write_tiny,
)

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
    with pytest.raises(InvalidError, match="not empty"):
        StreamWriter.create(tmp_path / "s", manifest)
    with pytest.raises(InvalidError, match="born at 0, expected -2"):
        writer.append(tiny_slice(0))
    slice = tiny_slice(-2)
    double = Splats.concatenate([slice.splats, slice.splats])
    with pytest.raises(InvalidError, match="80 Gaussians, at most 40"):
        writer.append(Slice(-2, double, np.zeros(80, np.uint8)))
    with pytest.raises(InvalidError, match="SH degree 1, not 0"):
        writer.append(Slice(-2, Splats.empty(1), np.zeros(0, np.uint8)))
    writer.append(slice)
    writer.close()
    writer.close()
    with pytest.raises(InvalidError, match="closed"):
        writer.append(tiny_slice(-1))
    assert StreamReader(tmp_path / "s").num_frames == 0
    with pytest.raises(InvalidError, match="finished"):
        StreamWriter.resume(tmp_path / "s")


def test_after_a_short_segment_nothing_follows(tmp_path: Path) -> None:
    path = tmp_path / "s"
    write_tiny(path, 6)
    live = replace(StreamReader(path).manifest, live=True)
    # Killed after the last record, before the manifest was marked as finished.
    (path / "manifest.json").write_bytes(live.to_json())
    with StreamWriter.resume(path) as writer:
        assert (writer.next_birth, writer.complete) == (6, True)
        with pytest.raises(InvalidError, match="nothing can follow"):
            writer.append(tiny_slice(6))
    assert not StreamReader(path).manifest.live


def too_late(birth: int) -> Slice:
    """A slice that the encoder refuses: one of its Gaussians never starts."""
    slice = tiny_slice(birth)
    return replace(slice, start_offsets=slice.start_offsets + np.uint8(3))


@pytest.mark.parametrize("birth", [-2, 0, 3, 9])
def test_a_slice_that_was_refused_leaves_nothing(
    tmp_path: Path, whole: dict[str, bytes], birth: int
) -> None:
    with StreamWriter.create(tmp_path / "s", tiny_manifest()) as writer:
        for good in range(-2, birth):
            writer.append(tiny_slice(good))
        for _ in range(2):
            with pytest.raises(InvalidError, match=r"s: update born at .*: start offset"):
                writer.append(too_late(birth))
        append_tiny(writer, NUM_FRAMES)
    assert files_of(tmp_path / "s") == whole


@pytest.mark.parametrize("birth", [0, 2, 3, 8, 9])
def test_a_refused_slice_and_then_the_end(tmp_path: Path, birth: int) -> None:
    with StreamWriter.create(tmp_path / "s", tiny_manifest()) as writer:
        for good in range(-2, birth):
            writer.append(tiny_slice(good))
        with pytest.raises(InvalidError):
            writer.append(too_late(birth))
    assert verify_stream(tmp_path / "s").num_frames == birth


@pytest.fixture(scope="module")
def updates() -> list[Update]:
    return patternless_updates(slots_manifest().slot_layout, NUM_FRAMES)


def test_an_update_that_was_refused_leaves_nothing(tmp_path: Path, updates: list[Update]) -> None:
    write_slots(tmp_path / "whole", NUM_FRAMES)
    with StreamWriter.create(tmp_path / "s", slots_manifest()) as writer:
        for update in updates:
            with pytest.raises(InvalidError, match="expected"):
                writer.append(replace(update, birth=update.birth + 1))
            with pytest.raises(InvalidError, match="at most 3"):
                writer.append(replace(update, statuses=update.statuses + 4))
            writer.append(update)
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
    kept, before = reader.slice(4, 2).splats, reader.slice(1, 2).splats
    assert (kept.means == before.means).all()


def test_an_exception_leaves_a_shorter_live_stream(tmp_path: Path) -> None:
    def write_and_fail() -> None:
        with StreamWriter.create(tmp_path / "s", tiny_manifest()) as writer:
            for birth in range(-2, 6):
                writer.append(tiny_slice(birth))
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        write_and_fail()
    summary = verify_stream(tmp_path / "s")
    assert (summary.num_frames, summary.live) == (4, True)


@pytest.mark.parametrize("kept", range(NUM_FRAMES + 3))
def test_a_writer_that_was_stopped_goes_on_with_the_same_bytes(
    updates: list[Update], tmp_path: Path, kept: int
) -> None:
    write_slots(tmp_path / "whole", NUM_FRAMES)
    path = tmp_path / "s"
    writer = StreamWriter.create(path, slots_manifest())
    for update in updates[:kept]:
        writer.append(update)
    durable = writer.durable_birth
    writer.abort()
    (path / "segments" / "7").mkdir()
    (path / "segments" / "7" / ".0.tmp").write_bytes(b"part")
    with open(path / "index.bin", "ab") as index:
        index.write(b"part")
    with StreamWriter.resume(path) as writer:
        assert writer.next_birth == durable
        for update in updates[writer.next_birth + 2 :]:
            writer.append(update)
    (path / "segments" / "7").rmdir()
    assert files_of(path) == files_of(tmp_path / "whole")
    records = StreamReader(path).records
    assert writer.bytes_written == sum(sum(record.part_bytes) for record in records)
    assert writer.played_bytes == sum(record.played_bytes for record in records)
