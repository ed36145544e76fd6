"""A folder that changes under the server: each change is noticed within a second, in real time."""

from __future__ import annotations

import asyncio
import hashlib
import logging
import os
import shutil
import sys
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from itertools import pairwise
from pathlib import Path

import pytest

from codec.errors import CodecError
from codec.stream import StreamWriter
from server.library import Library, ServedStream
from tests.support.server.running_server import (
    SEGMENT_FRAMES,
    append_frames,
    births_of,
    live_stream,
    make_stream,
    random_slice,
    small_manifest,
)

BOUND_S = 2.0
"""Time that the tests allow on a busy machine; the promise is one second."""


@asynccontextmanager
async def watching(root: Path, refresh_s: float = 0.5) -> AsyncIterator[Library]:
    library = Library(root, refresh_s)
    watch = asyncio.create_task(library.watch())
    try:
        yield library
    finally:
        watch.cancel()
        with pytest.raises(asyncio.CancelledError):
            await watch


async def noticed(condition: Callable[[], object], what: str) -> None:
    """Fails unless `condition` becomes true within BOUND_S; prints the time that it took."""
    began_s = time.monotonic()
    while not condition():
        assert time.monotonic() - began_s < BOUND_S, what
        await asyncio.sleep(0.005)
    sys.stdout.write(f"{what}: noticed after {time.monotonic() - began_s:.3f} s\n")


def other_stream(path: Path, num_frames: int, title: str = "") -> Path:
    """A stream with the manifest of `make_stream`, and other slices."""
    with StreamWriter.create(path, small_manifest(title=title)) as writer:
        for birth in births_of(num_frames):
            writer.append(random_slice(birth, 7))
    return path


def files_of(stream: Path) -> list[Path]:
    return sorted(path.relative_to(stream) for path in stream.rglob("*") if path.is_file())


def copy_slowly(source: Path, target: Path, names: list[Path], pause_s: float) -> None:
    """Copies file by file, each in two halves, like a slow copy."""
    for name in names:
        data, path = (source / name).read_bytes(), target / name
        path.parent.mkdir(parents=True, exist_ok=True)
        with open(path, "wb", buffering=0) as file:
            file.write(data[: len(data) // 2])
            time.sleep(pause_s)
            file.write(data[len(data) // 2 :])
        time.sleep(pause_s)


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
        async with watching(root) as library:
            await asyncio.sleep(0.1)
            shutil.copytree(whole, root / "one")
            await noticed(lambda: "one" in library.streams, "a new stream")
            stream = library.streams["one"]
            (root / "one" / "index.bin").unlink()
            await noticed(lambda: "one" in library.broken, "a broken stream")
            assert "one" not in library.streams
            assert stream.gone
            assert library.broken["one"].startswith("index.bin is missing")
            shutil.copy(whole / "index.bin", root / "one")
            await noticed(lambda: "one" in library.streams, "a repaired stream")
            assert library.broken == {}
            assert library.streams["one"] is not stream
            (root / "one" / "manifest.json").chmod(0o000)
            (root / "one" / "manifest.json").chmod(0o644)
            shutil.rmtree(root / "one")
            await noticed(lambda: not library.streams, "a deleted stream")
            await noticed(lambda: not library.broken, "the rest of it")
            before = len(caplog.records)
            await asyncio.sleep(1.2)
            assert len(caplog.records) == before, "nothing changed, and nothing is said"

    asyncio.run(check())
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
        other_stream(new, 12)  # the same manifest, sizes of files that may be the same
    else:
        other_stream(new, 17, title="another")

    async def check() -> None:
        async with watching(root) as library:
            old = library.streams["s"]
            tag = old.view.index_sha256
            await asyncio.sleep(0.1)  # the first look is over
            if how == "rename":
                (root / "s").rename(tmp_path / "away")
                new.rename(root / "s")
            else:
                if how == "delete and copy":
                    shutil.rmtree(root / "s")
                shutil.copytree(new, root / "s", dirs_exist_ok=True)
            await noticed(lambda: library.find("s") not in (old, None), f"replaced by {how}")
            assert old.gone
            assert old.view.index_sha256 == tag
            # Objects of the old stream never get the bytes of the new one.
            with pytest.raises(CodecError, match=r"segments/1/0"):
                old.read_object(1, 0)
            fresh = library.streams["s"]
            assert fresh.generation != old.generation
            assert fresh.view.index_sha256 != tag
            check_whole(fresh)

    asyncio.run(check())


@pytest.mark.parametrize("last", ["manifest.json", "index.bin", "segments/2/3", "segments/0/0"])
def test_a_half_copied_stream_is_broken_until_it_is_whole(tmp_path: Path, last: str) -> None:
    whole, root = make_stream(tmp_path / "whole", 12), tmp_path / "root"
    root.mkdir()
    names = sorted(files_of(whole), key=lambda name: str(name) == last)

    async def check() -> None:
        async with watching(root, 0.02) as library:
            copying = asyncio.create_task(
                asyncio.to_thread(copy_slowly, whole, root / "s", names, 0.02)
            )
            reasons = set()
            while not copying.done():
                reasons.add(library.broken.get("s", ""))
                for stream in library.streams.values():
                    check_whole(stream)
                await asyncio.sleep(0.01)
            await noticed(lambda: "s" in library.streams, f"whole with {last}")
            check_whole(library.streams["s"])
            assert library.streams["s"].num_frames == 12
            if last != "manifest.json":
                assert any(reason.startswith(last) for reason in reasons), reasons

    asyncio.run(check())


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
        assert library.find("s") is stream

    asyncio.run(check())


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read everything")
def test_what_may_not_be_read_is_served_once_it_may(tmp_path: Path) -> None:
    path = make_stream(tmp_path / "root" / "s", 3) / "index.bin"
    path.chmod(0o000)

    async def check() -> None:
        async with watching(tmp_path / "root") as library:
            assert "cannot be read" in library.broken["s"]
            path.chmod(0o644)
            await noticed(lambda: "s" in library.streams, "a permission")

    asyncio.run(check())


@pytest.mark.realtime
def test_a_look_that_finds_nothing_new_only_looks_at_stamps(tmp_path: Path) -> None:
    """20 finished streams and a broken one: the cost of a look, which opens nothing."""
    for number in range(20):
        make_stream(tmp_path / f"s{number}", 3)
    (tmp_path / "s0" / "segments" / "0" / "0").unlink()
    library = Library(tmp_path, 1.0)
    opened: list[str] = []
    on = True

    def hook(event: str, arguments: tuple[object, ...]) -> None:
        if on and event == "open" and str(tmp_path) in str(arguments[0]):
            opened.append(str(arguments[0]))

    sys.addaudithook(hook)

    async def timed(look: Callable[[], Awaitable[None]], times: int) -> float:
        began_s = time.process_time()
        for _ in range(times):
            await look()
        return (time.process_time() - began_s) / times

    cost_s = asyncio.run(timed(library.look, 50))
    on = False
    sys.stdout.write(f"a look at 20 streams: {1e3 * cost_s:.2f} ms of processor time\n")
    assert opened == []
    assert cost_s < 0.05
