"""The table of streams: what is served, under which name, and how it follows growth."""

from __future__ import annotations

import asyncio
import os
import shutil
from pathlib import Path

import pytest

from codec.errors import CodecError, SwingsError
from codec.stream import StreamReader, StreamWriter
from codec.stream.index import record_bytes
from server.cache import ObjectCache
from server.library import Library
from server.metrics import Metrics
from tests.support.hostile import put_object
from tests.support.running_server import (
    SEGMENT_FRAMES,
    births_of,
    make_stream,
    random_slice,
    small_manifest,
)


def test_a_stream_is_called_after_its_folder(tmp_path: Path) -> None:
    root = make_stream(tmp_path / "walk-1", 7)
    assert list(Library(root, 1.0).streams) == ["walk-1"]


def test_a_folder_of_streams(tmp_path: Path) -> None:
    make_stream(tmp_path / "b", 3)
    make_stream(tmp_path / "a", 3)
    make_stream(tmp_path / ".hidden", 3)
    (tmp_path / "notes").mkdir()
    (tmp_path / "notes" / "readme.txt").write_text("x")
    assert list(Library(tmp_path, 1.0).streams) == ["a", "b"]


def test_a_relative_root_has_a_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(make_stream(tmp_path / "here", 3))
    assert list(Library(Path(), 1.0).streams) == ["here"]


@pytest.mark.parametrize("name", ["a b", "ü", "-x", "a" * 81, "a\nb"])
def test_a_name_that_needs_quoting_is_refused(tmp_path: Path, name: str) -> None:
    make_stream(tmp_path / name, 3)
    for root in (tmp_path, tmp_path / name):
        with pytest.raises(SwingsError, match="rename it"):
            Library(root, 1.0)


def test_what_is_not_a_stream_is_said_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(SwingsError, match="is not a folder"):
        Library(tmp_path / "absent", 1.0)
    with pytest.raises(SwingsError, match="holds no stream"):
        Library(tmp_path, 1.0)


@pytest.mark.parametrize("name", ["manifest.json", "index.bin"])
def test_a_damaged_stream_names_its_file(tmp_path: Path, name: str) -> None:
    path = make_stream(tmp_path / "s", 12) / name
    data = bytearray(path.read_bytes())
    data[10] ^= 0xFF
    path.write_bytes(data)
    with pytest.raises(CodecError, match=rf"{name}: byte \d+: ") as caught:
        Library(tmp_path, 1.0)
    assert caught.value.at is not None


def test_it_follows_a_live_stream_but_not_all_the_time(tmp_path: Path) -> None:
    writer = StreamWriter.create(tmp_path / "live", small_manifest())

    async def check() -> None:
        library = Library(tmp_path, 1.0)
        stream = await library.find("live", 10.0)
        assert stream is not None
        assert (stream.num_frames, stream.live) == (0, True)
        tag = stream.view.index_sha256
        for birth in births_of(2 * SEGMENT_FRAMES):
            writer.append(random_slice(birth, 8))
        await library.find("live", 10.9)
        assert stream.num_frames == 0
        await asyncio.gather(*(library.find("live", 11.1) for _ in range(5)))
        assert stream.num_frames == 2 * SEGMENT_FRAMES
        assert stream.view.index_sha256 != tag
        assert stream.view.index_bytes == (tmp_path / "live" / "index.bin").stat().st_size
        writer.close()
        await library.find("live", 12.2)
        assert not stream.live
        # The tag depends on the records, not on when they were seen.
        again = Library(tmp_path, 1.0).streams["live"]
        assert again.view.index_sha256 == stream.view.index_sha256

    asyncio.run(check())


def test_new_streams_turn_up_and_damaged_ones_are_told_once(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    make_stream(tmp_path / "first", 3)

    async def check() -> None:
        library = Library(tmp_path, 1.0)
        assert await library.find("second", 10.0) is None
        make_stream(tmp_path / "second", 3)
        (tmp_path / "bad").mkdir()
        (tmp_path / "bad" / "manifest.json").write_text("{}")
        assert await library.find("second", 10.5) is None
        assert await library.find("second", 11.5) is not None
        assert await library.find("bad", 13.0) is None
        assert await library.find("bad", 15.0) is None

    asyncio.run(check())
    assert len([r for r in caplog.records if "bad" in r.getMessage()]) == 1


def test_a_live_stream_that_breaks_keeps_its_last_good_view(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    writer = StreamWriter.create(tmp_path / "live", small_manifest())
    for birth in births_of(2 * SEGMENT_FRAMES):
        writer.append(random_slice(birth, 8))
    writer.abort()
    library = Library(tmp_path, 1.0)
    with open(tmp_path / "live" / "index.bin", "ab") as file:
        file.write(b"\x01" * 2 * record_bytes(4))

    async def check() -> None:
        for now_s in (10.0, 12.0, 14.0):
            stream = await library.find("live", now_s)
            assert stream is not None
            assert stream.num_frames == 2 * SEGMENT_FRAMES
            assert stream.read_index(0, stream.view.index_bytes)

    asyncio.run(check())
    assert len([r for r in caplog.records if "index.bin" in r.getMessage()]) == 1


def test_sizes_are_means_over_the_segment(tmp_path: Path) -> None:
    root = make_stream(tmp_path / "s", 12)
    stream = Library(root, 1.0).streams["s"]
    reader = StreamReader(root)
    for birth, segment, count in ((-3, 0, 8), (4, 0, 8), (5, 1, 5), (11, 2, 2)):
        sizes = reader.records[segment].object_bytes
        means = stream.sizes(birth)
        assert means.layer_bytes == tuple(size / count for size in sizes)
        assert means is stream.sizes(birth)


def test_the_cache_is_bounded_and_reads_once(tmp_path: Path) -> None:
    root = make_stream(tmp_path / "s", 30)
    one_bytes = os.path.getsize(root / "segments" / "1" / "0")

    async def check() -> None:
        stream = Library(root, 1.0).streams["s"]
        metrics = Metrics()
        cache = ObjectCache(3 * one_bytes + 100, metrics)
        loaded = await asyncio.gather(*(cache.load(stream, 1, 0) for _ in range(10)))
        assert all(one is loaded[0] for one in loaded)
        assert metrics.cache_misses.value() == 1
        for segment in range(6):
            found = await cache.load(stream, segment, 0)
            assert found.data == stream.read_object(segment, 0).data
            assert cache.size_bytes <= 3 * one_bytes + 100
        hits = metrics.cache_hits.value()
        await cache.load(stream, 5, 0)
        assert metrics.cache_hits.value() == hits + 1
        # Nothing is cached that is too large alone.
        tiny = ObjectCache(10, Metrics())
        assert (await tiny.load(stream, 0, 0)).data == stream.read_object(0, 0).data
        assert tiny.size_bytes == 0

    asyncio.run(check())


def test_an_altered_object_is_never_loaded(tmp_path: Path) -> None:
    root = make_stream(tmp_path / "s", 12)
    path = root / "segments" / "1" / "2"
    data = bytearray(path.read_bytes())
    data[-1] ^= 1

    async def check() -> None:
        stream = Library(root, 1.0).streams["s"]
        cache = ObjectCache(1 << 20, Metrics())
        path.write_bytes(data)
        with pytest.raises(CodecError, match=r"segments/1/2"):
            await cache.load(stream, 1, 2)
        shutil.rmtree(path.parent)
        with pytest.raises(CodecError):
            await cache.load(stream, 1, 2)
        assert cache.size_bytes == 0

    asyncio.run(check())


def test_an_object_with_the_wrong_births_is_named_with_the_byte(tmp_path: Path) -> None:
    root = make_stream(tmp_path / "s", 12)
    data = (root / "segments" / "1" / "2").read_bytes()
    put_object(root, 1, 2, data[:20] + bytes([4, 0, 0, 0]) + data[24:])

    async def check() -> None:
        stream = Library(root, 1.0).streams["s"]
        with pytest.raises(CodecError, match=r"segments/1/2: byte 20: .* not 5\.\.9") as caught:
            await ObjectCache(1 << 20, Metrics()).load(stream, 1, 2)
        assert caught.value.at == 20

    asyncio.run(check())
