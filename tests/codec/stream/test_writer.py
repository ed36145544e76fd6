"""Slices that a writer refuses, and its resumption after a stop."""

from __future__ import annotations

from collections.abc import Callable
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
from tests.support.slots.updates import patternless_updates, small_layout
from tests.support.tiny_stream import append_tiny, files_of, tiny_manifest, tiny_slice, write_tiny

NUM_FRAMES = 10


def test_what_the_writer_refuses(tmp_path: Path) -> None:
    manifest = tiny_manifest()
    with pytest.raises(InvalidError, match="no rank is called 'size'"):
        StreamWriter.create(tmp_path / "s", manifest, rank="size")  # type: ignore[arg-type]
    writer = StreamWriter.create(tmp_path / "s", manifest)
    with pytest.raises(InvalidError, match="not empty"):
        StreamWriter.create(tmp_path / "s", manifest)
    slice = tiny_slice(-2)
    double = Splats.concatenate([slice.splats, slice.splats])
    for wrong, message in (
        (tiny_slice(0), "born at 0, expected -2"),
        (Slice(-2, double, np.zeros(80, np.uint8)), "80 Gaussians, at most 40"),
        (Slice(-2, Splats.empty(1), np.zeros(0, np.uint8)), "SH degree 1, not 0"),
    ):
        with pytest.raises(InvalidError, match=message):
            writer.append(wrong)
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


def test_an_update_that_was_refused_leaves_nothing(tmp_path: Path) -> None:
    with StreamWriter.create(tmp_path / "s", slots_manifest()) as writer:
        for update in write_slots(tmp_path / "whole", NUM_FRAMES):
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
    assert (reader.slice(4, 2).splats.means == reader.slice(1, 2).splats.means).all()


def test_an_exception_leaves_a_shorter_live_stream(tmp_path: Path) -> None:
    def write_and_fail() -> None:
        with StreamWriter.create(tmp_path / "s", tiny_manifest()) as writer:
            append_tiny(writer, 6)
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        write_and_fail()
    summary = verify_stream(tmp_path / "s")
    assert (summary.num_frames, summary.live) == (4, True)


@pytest.mark.parametrize("kept", range(NUM_FRAMES + 3))
@pytest.mark.parametrize("period", [1, 2])
def test_a_stopped_writer_goes_on(tmp_path: Path, period: int, kept: int) -> None:
    layout = small_layout(3, (9, 6), 0, 4) if period == 1 else small_layout(1, (5, 3), 0, 4, period)
    manifest, path = slots_manifest(layout), tmp_path / "s"
    plain = small_layout(layout.swin_size, (9, 6) if period == 1 else (5, 3), 0, 4)
    updates = patternless_updates(plain, NUM_FRAMES)

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
