"""The table of streams: served streams, their names, and reasons why others are not served."""

from __future__ import annotations

import asyncio
import logging
import os
import re
import resource
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from codec.errors import SwingsError
from codec.storage.storage import Storage
from codec.stream import StreamReader
from codec.stream.reader import read_stream_file
from codec.stream.segment import record_bytes
from server.library import Library, entry
from server.library.entry import one_line
from tests.support.server.running_server import (
    SEGMENT_FRAMES,
    SWIN_SIZE,
    append_frames,
    live_stream,
    make_stream,
)
from tests.support.slots.slot_streams import write_slot_stream
from tests.support.slots.updates import small_layout


def look(library: Library) -> None:
    asyncio.run(library.look())


def said(caplog: pytest.LogCaptureFixture) -> list[str]:
    """The lines of the log, without the folder's name in front."""
    return [record.getMessage().rpartition("/")[2] for record in caplog.records]


def test_streams_are_called_after_their_folders(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("b-1", "a", ".hidden"):
        make_stream(tmp_path / name, 3)
    (tmp_path / "notes").mkdir()
    (tmp_path / "notes" / "readme.txt").write_text("x")
    library = Library(tmp_path, 1.0)
    assert (list(library.streams), library.broken) == (["a", "b-1"], {})
    monkeypatch.chdir(tmp_path / "b-1")
    for root in (tmp_path / "b-1", Path()):
        assert list(Library(root, 1.0).streams) == ["b-1"]


def test_an_empty_root_is_served_and_its_first_stream_says_what_it_is(tmp_path: Path) -> None:
    folder, stream = Library(tmp_path, 1.0), tmp_path / "one"
    stream.mkdir()
    single = Library(stream, 1.0)
    assert folder.streams == single.streams == {}
    make_stream(stream, 3)
    for library in (folder, single):
        look(library)
        assert list(library.streams) == ["one"]
    # A stray manifest does not turn a folder of streams into a stream.
    (tmp_path / "manifest.json").write_text("{}")
    look(folder)
    assert (list(folder.streams), folder.broken) == (["one"], {})


@pytest.mark.parametrize("name", ["a b", "ü", "-x", "a" * 81, "a\nb", "\x1b[31m"])
def test_a_name_that_needs_quoting_is_refused_and_shown_without_harm(
    tmp_path: Path, name: str, caplog: pytest.LogCaptureFixture
) -> None:
    make_stream(tmp_path / name, 3)
    make_stream(tmp_path / "good", 3)
    for root in (tmp_path, tmp_path / name):
        library = Library(root, 1.0)
        look(library)
        (shown, reason), *others = library.broken.items()
        assert not others
        assert shown.isprintable()
        assert len(shown) <= 80
        assert "rename it" in reason
    lines = [line for line in said(caplog) if "rename it" in line]
    assert len(lines) == 2
    assert all(line.isprintable() for line in lines)
    assert list(Library(tmp_path, 1.0).streams) == ["good"]


def a_link_out(stream: Path, name: str) -> None:
    root = next(folder for folder in stream.parents if folder.name == "root")
    outside = root.with_name(f"outside-{name}")
    shutil.move(stream / name, outside)
    (stream / name).symlink_to(outside)


def a_link_in_a_circle(stream: Path, name: str) -> None:
    (stream / name).unlink()
    (stream / name).symlink_to(name)


def huge(stream: Path, name: str) -> None:
    with open(stream / name, "ab") as file:
        file.truncate(1 << 40)


def altered(stream: Path, name: str) -> None:
    data = bytearray((stream / name).read_bytes())
    data[10] ^= 0xFF
    (stream / name).write_bytes(data)


def emptied(stream: Path, name: str) -> None:
    (stream / name).write_bytes(b"")


ODD: list[tuple[Callable[[Path, str], None], str]] = [
    (a_link_out, r"{name} cannot be read: a link points outside its folder"),
    (a_link_in_a_circle, r"the stream cannot be read; see the server's log"),
    (huge, r"{name} is longer than \d+ bytes"),
    (altered, r"{name}: byte \d+: .*"),
]


@pytest.mark.timeout(20)
@pytest.mark.parametrize("name", ["manifest.json", "index.bin"])
@pytest.mark.parametrize(("make", "reason"), ODD)
def test_a_broken_stream_is_named_with_its_reason_and_the_others_are_served(
    tmp_path: Path,
    name: str,
    make: Callable[[Path, str], None],
    reason: str,
    caplog: pytest.LogCaptureFixture,
) -> None:
    root = tmp_path / "root"
    whole = make_stream(tmp_path / "whole", 12)
    make_stream(root / "good", 3)
    stream = shutil.copytree(whole, root / "bad")
    make(stream, name)
    library = Library(root, 1.0)
    look(library)
    assert list(library.streams) == ["good"]
    assert list(library.broken) == ["bad"]
    assert re.fullmatch(reason.replace("{name}", name), library.broken["bad"])
    assert str(tmp_path) not in library.broken["bad"]
    (line,) = [r for r in caplog.records if "bad" in r.getMessage()]
    assert line.levelno == logging.WARNING
    assert line.getMessage().startswith(f"{stream} is not served: ")
    assert name in line.getMessage()
    # Once repaired, it is served; then another one may break in the same way.
    shutil.rmtree(stream)
    shutil.copytree(whole, stream)
    look(library)
    assert (list(library.streams), library.broken) == (["bad", "good"], {})


@pytest.mark.timeout(20)
@pytest.mark.parametrize("make", [a_link_out, huge, emptied])
def test_objects_are_regular_files_of_the_right_size(
    tmp_path: Path, make: Callable[[Path, str], None]
) -> None:
    make_stream(tmp_path / "root" / "good", 3)
    stream = make_stream(tmp_path / "root" / "bad", 60)
    make(stream / "segments" / "1", "2")
    library = Library(tmp_path / "root", 1.0)
    assert list(library.streams) == ["good"]
    assert library.broken["bad"].startswith("segments/1/2 ")
    # A file that becomes invalid while it is served is an error at its next read.
    good = library.streams["good"]
    make(tmp_path / "root" / "good" / "segments" / "0", "1")
    with pytest.raises(SwingsError, match=r"segments/0/1"):
        good.read_object(0, 1)


def test_a_folder_that_links_out_of_the_root_is_not_served(tmp_path: Path) -> None:
    make_stream(tmp_path / "elsewhere" / "s", 3)
    root = tmp_path / "root"
    make_stream(root / "good", 3)
    (root / "inside").symlink_to("good")
    (root / "out").symlink_to(tmp_path / "elsewhere" / "s")
    library = Library(root, 1.0)
    assert list(library.streams) == ["good", "inside"]
    assert library.broken == {
        "out": "manifest.json cannot be read: a link points outside its folder"
    }
    # The root itself may be a link.
    (tmp_path / "link").symlink_to(root)
    assert list(Library(tmp_path / "link", 1.0).streams) == ["good", "inside"]


def test_the_reason_of_a_stranger_is_one_line_of_letters() -> None:
    assert one_line("a\x1b[31m\nb\u202e") == "a\\x1b[31m\\nb\\u202e"
    assert len(one_line("x" * 10_000)) < 310


def test_a_live_stream_that_breaks_keeps_its_last_good_view(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    live_stream(tmp_path / "live", 2 * SEGMENT_FRAMES).abort()
    library = Library(tmp_path, 1.0)
    stream = library.streams["live"]
    with open(tmp_path / "live" / "index.bin", "ab") as file:
        file.write(b"\x01" * 2 * record_bytes(4))
    for _ in range(3):
        look(library)
        assert library.streams.get("live") is stream
        assert stream.num_frames == 2 * SEGMENT_FRAMES
    lines = [line for line in said(caplog) if "index.bin" in line]
    assert len(lines) == 1
    assert lines[0].startswith("live no longer grows: index.bin: byte ")


def test_a_root_that_goes_keeps_what_is_served_until_it_comes_back(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    make_stream(tmp_path / "root" / "one", 3)
    library = Library(tmp_path / "root", 1.0)
    stream = library.streams["one"]
    (tmp_path / "root").rename(tmp_path / "away")
    for _ in range(3):
        look(library)
        assert library.streams.get("one") is stream
    assert len(said(caplog)) == 1
    (tmp_path / "away").rename(tmp_path / "root")
    make_stream(tmp_path / "root" / "two", 3)
    look(library)
    assert list(library.streams) == ["one", "two"]
    assert library.streams.get("one") is stream
    assert len(said(caplog)) == 2


def test_a_stream_that_is_replaced_while_it_is_read_is_not_mixed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The stream is replaced between the reads of its manifest and of its index."""
    make_stream(tmp_path / "root" / "s", 12, title="old")
    new = make_stream(tmp_path / "new", 7, title="new")
    read, left = read_stream_file, [True]

    def read_and_replace(storage: Storage, path: str, limit_bytes: int) -> bytes:
        data = read(storage, path, limit_bytes)
        if left.pop() if left else False:
            (tmp_path / "root" / "s").rename(tmp_path / "away")
            new.rename(tmp_path / "root" / "s")
        return data

    monkeypatch.setattr(entry, "read_stream_file", read_and_replace)
    library = Library(tmp_path / "root", 1.0)
    assert library.streams == {}
    look(library)
    view = library.streams["s"].view
    assert (view.manifest.title, view.num_frames) == ("new", 7)


def is_open(descriptor: int) -> bool:
    try:
        os.fstat(descriptor)
    except OSError:
        return False
    return True


def test_a_process_without_descriptors_keeps_what_it_serves(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """This holds for any number left: it may list the folder and then open nothing."""
    writer = live_stream(tmp_path / "live")
    make_stream(tmp_path / "other", 3)
    library = Library(tmp_path, 1.0)
    served = dict(library.streams)
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)

    async def check() -> None:
        await library.look()  # starts the thread
        append_frames(writer)
        free = [number for number in range(1024) if not is_open(number)]
        outcomes = set()
        for spare in range(6):
            resource.setrlimit(resource.RLIMIT_NOFILE, (free[spare], hard))
            try:
                await library.look()
            finally:
                resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
            assert library.streams == served
            assert library.broken == {}
            outcomes.add(served["live"].num_frames)
        assert outcomes == {0, SEGMENT_FRAMES}

    asyncio.run(check())
    lines = [record.getMessage() for record in caplog.records]
    assert any("Too many open files" in line for line in lines)
    assert len(lines) <= 3, lines


def test_sizes_are_means_over_the_segment(tmp_path: Path) -> None:
    root = make_stream(tmp_path / "s", 12)
    stream = Library(root, 1.0).streams["s"]
    reader = StreamReader(root)
    for birth, segment, count in ((0, 0, 5), (4, 0, 5), (5, 1, 5), (11, 2, 2)):
        record, means = reader.records[segment], stream.sizes(birth)
        skip_maps_bytes, *keyframe_bytes = record.side_bytes
        first, *others = record.object_bytes
        totals = [first + skip_maps_bytes, *others]
        assert means.layer_bytes == pytest.approx([size / count for size in totals])
        assert means.keyframe_bytes == tuple(keyframe_bytes)
        assert list(means.psnr_db) == sorted(means.psnr_db)
        assert means is stream.sizes(birth)


def test_a_slice_changes_no_more_than_its_lane(tmp_path: Path) -> None:
    """Slices that are sent whole change one in `swin_size` slots."""
    make_stream(tmp_path / "whole", 12)
    write_slot_stream(tmp_path / "slots", 60, small_layout(3, (40, 40), 0, 30))
    streams = Library(tmp_path, 1.0).streams
    assert streams["whole"].sizes(5).changed_shares == (1 / SWIN_SIZE,) * 4
    assert all(0 < share <= 1 / 3 for share in streams["slots"].sizes(31).changed_shares)
