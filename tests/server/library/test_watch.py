"""A folder that changes under the server: the next look notices each change."""

from __future__ import annotations

import asyncio
import hashlib
import logging
import shutil
import sys
from itertools import pairwise
from pathlib import Path

import pytest

from codec.errors import CodecError
from server.library import Library, ServedStream
from tests.support.server.running_server import (
    SEGMENT_FRAMES,
    append_frames,
    live_stream,
    make_stream,
)
from tests.support.server.virtualtime import passes, virtually


def files_of(stream: Path) -> list[Path]:
    return sorted(path.relative_to(stream) for path in stream.rglob("*") if path.is_file())


def check_whole(stream: ServedStream) -> None:
    """Asserts that everything in the stream can be read, and matches its tags."""
    view = stream.view
    assert hashlib.sha256(view.manifest_json).hexdigest() == view.manifest_sha256
    assert hashlib.sha256(view.index_data).hexdigest() == view.index_sha256
    for segment in range(view.num_segments):
        for part in view.manifest.parts:
            data = stream.read_object(segment, part).data
            assert hashlib.sha256(data).hexdigest() == stream.object_sha256(segment, part)


def test_streams_come_go_break_and_are_repaired(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO, "server.library")
    whole, root = make_stream(tmp_path / "whole", 12), tmp_path / "root"
    root.mkdir()

    async def check() -> None:
        library = Library(root, 0.5)
        watch = asyncio.create_task(library.watch())
        await passes(0.1)
        shutil.copytree(whole, root / "one")
        await passes(0.5)
        stream = library.streams["one"]
        (root / "one" / "index.bin").unlink()
        await passes(0.5)
        assert library.broken["one"].startswith("index.bin is missing")
        assert "one" not in library.streams
        assert stream.gone
        shutil.copy(whole / "index.bin", root / "one")
        await passes(0.5)
        assert library.broken == {}
        assert library.streams["one"] is not stream
        (root / "one" / "manifest.json").chmod(0o000)
        (root / "one" / "manifest.json").chmod(0o644)
        shutil.rmtree(root / "one")
        await passes(0.5)
        assert (library.streams, library.broken) == ({}, {})
        before = len(caplog.records)
        await passes(5)
        assert len(caplog.records) == before, "nothing changed, and nothing is said"
        watch.cancel()

    virtually(check())
    lines = [r.getMessage().rpartition("/")[2].partition(":")[0] for r in caplog.records]
    assert lines[:3] == ["one is served", "one is not served", "one is served"]
    assert lines[-1] == "one was removed"
    assert len(lines) <= 5
    assert all(first != second for first, second in pairwise(lines))


@pytest.mark.parametrize("how", ["rename", "delete and copy", "copy over"])
@pytest.mark.parametrize("alike", [True, False])
def test_a_replaced_stream_is_another_one(tmp_path: Path, how: str, alike: bool) -> None:
    root, new = tmp_path / "root", tmp_path / "new"
    make_stream(root / "s", 12)
    if alike:
        make_stream(new, 12, num_empty=1)  # the same manifest, sizes of files that may be the same
    else:
        make_stream(new, 17, title="another", num_empty=1)

    library = Library(root, 1.0)
    old = library.streams["s"]
    tag = old.view.index_sha256
    if how == "rename":
        (root / "s").rename(tmp_path / "away")
        new.rename(root / "s")
    else:
        if how == "delete and copy":
            shutil.rmtree(root / "s")
        shutil.copytree(new, root / "s", dirs_exist_ok=True)
    asyncio.run(library.look())
    assert library.streams.get("s") not in (old, None)
    assert old.gone
    assert old.view.index_sha256 == tag
    # Objects of the old stream never get the bytes of the new one.
    with pytest.raises(CodecError, match=r"segments/1/0"):
        old.read_object(1, 0)
    fresh = library.streams["s"]
    assert fresh.generation != old.generation
    assert fresh.view.index_sha256 != tag
    check_whole(fresh)


@pytest.mark.parametrize("last", ["manifest.json", "index.bin", "segments/2/3", "segments/0/0"])
def test_a_half_copied_stream_is_broken_until_it_is_whole(tmp_path: Path, last: str) -> None:
    whole, root = make_stream(tmp_path / "whole", 12), tmp_path / "root"
    root.mkdir()
    names = sorted(files_of(whole), key=lambda name: str(name) == last)

    library, reasons = Library(root, 1.0), set()
    for name in names:
        data, path = (whole / name).read_bytes(), root / "s" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        for part in (data[: len(data) // 2], data):
            path.write_bytes(part)
            asyncio.run(library.look())
            reasons.add(library.broken.get("s", ""))
            for stream in library.streams.values():
                check_whole(stream)
    assert library.streams["s"].num_frames == 12
    if last != "manifest.json":
        assert any(reason.startswith(last) for reason in reasons), reasons


def test_an_index_that_is_copied_before_its_objects_waits_for_them(tmp_path: Path) -> None:
    source, root = tmp_path / "source", tmp_path / "root"
    writer = live_stream(source, 2 * SEGMENT_FRAMES)
    shutil.copytree(source, root / "s")
    append_frames(writer, 2 * SEGMENT_FRAMES)
    # A server that starts then offers what has arrived.
    shutil.copytree(root / "s", tmp_path / "early" / "s")
    shutil.copy(source / "index.bin", tmp_path / "early" / "s")
    early = Library(tmp_path / "early", 1.0).streams["s"]
    assert (early.view.num_segments, early.live) == (2, True)
    check_whole(early)
    writer.close()
    held_back = ["segments/2/1", "segments/3/3"]

    async def check() -> None:
        library = Library(root, 1.0)
        stream = library.streams["s"]
        for name in files_of(source):
            (root / "s" / name).parent.mkdir(exist_ok=True)
            if str(name) not in held_back:
                shutil.copy(source / name, root / "s" / name)
        seen = []
        for late in ["", *held_back]:
            if late:
                shutil.copy(source / late, root / "s" / late)
            await library.look()
            check_whole(stream)
            seen.append((stream.view.num_segments, stream.live))
        assert seen == [(2, True), (3, True), (4, False)]
        assert library.streams.get("s") is stream

    asyncio.run(check())


def test_a_look_that_finds_nothing_new_only_looks_at_stamps(tmp_path: Path) -> None:
    for number in range(3):
        make_stream(tmp_path / f"s{number}", 3)
    (tmp_path / "s0" / "segments" / "0" / "0").unlink()
    library = Library(tmp_path, 1.0)
    opened: list[str] = []
    on = True

    def hook(event: str, arguments: tuple[object, ...]) -> None:
        if on and event == "open" and str(tmp_path) in str(arguments[0]):
            opened.append(str(arguments[0]))

    sys.addaudithook(hook)

    asyncio.run(library.look())
    on = False
    assert opened == []
