"""A library in an object store: the same behaviour, on a real S3 server."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from pathlib import Path

import pytest

from codec.errors import CodecError, SwingsError
from server.library import Library
from server.library.servedstream import LIVE_POLL_S
from tests.server.library.test_watch import check_whole
from tests.support.server.running_server import (
    SEGMENT_FRAMES,
    append_frames,
    live_stream,
    make_stream,
)
from tests.support.server.virtualtime import now_s, virtually
from tests.support.stores.s3_server import BUCKET, S3Server, s3_server

ROOT = f"s3://{BUCKET}/root"


@pytest.fixture
def server() -> Iterator[S3Server]:
    with s3_server() as server:
        yield server


def test_streams_come_go_break_and_are_repaired(server: S3Server, tmp_path: Path) -> None:
    whole, other = make_stream(tmp_path / "whole", 12), make_stream(tmp_path / "other", 7)
    index = (whole / "index.bin").read_bytes()

    library = Library(ROOT, 0.5)

    def look() -> None:
        asyncio.run(library.look())

    server.upload(whole, "root/one")
    look()
    stream = library.streams["one"]
    check_whole(stream)
    server.put("root/one/index.bin", b"\x01" + index[1:])
    look()
    assert library.broken["one"].startswith("index.bin: byte ")
    assert stream.gone
    server.put("root/one/index.bin", index)
    look()
    assert library.broken == {}
    before = library.streams["one"]
    server.upload(other, "root/one")
    look()
    assert library.streams.get("one") not in (before, None)
    assert before.gone
    with pytest.raises(CodecError):
        before.read_object(1, 0)
    check_whole(library.streams["one"])
    server.delete("root/one")
    look()
    assert (library.streams, library.broken) == ({}, {})


def test_a_live_stream_is_followed_and_may_be_waited_for(server: S3Server, tmp_path: Path) -> None:
    writer = live_stream(tmp_path / "s")
    server.upload(tmp_path / "s", "root/live")

    def mirror() -> None:
        """Uploads one more segment like a mirror: objects first."""
        segment = max(writer.next_birth, 0) // SEGMENT_FRAMES
        append_frames(writer)
        folder = tmp_path / "s" / "segments" / str(segment)
        server.upload(folder, f"root/live/segments/{segment}")
        server.put("root/live/index.bin", (tmp_path / "s" / "index.bin").read_bytes())

    async def check() -> None:
        library = Library(ROOT, 3600.0)
        stream = library.streams["live"]
        for number in range(3):
            waiter = asyncio.create_task(stream.wait_for_growth(number, 10.0))
            mirror()
            grown_s = now_s()
            await waiter
            assert stream.view.num_segments == number + 1
            assert now_s() - grown_s <= LIVE_POLL_S
        check_whole(stream)

    virtually(check())


def test_a_store_that_fails_keeps_what_is_served(
    server: S3Server, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    live_stream(tmp_path / "s", SEGMENT_FRAMES)
    server.upload(tmp_path / "s", "root/s")

    async def check() -> None:
        library = Library(ROOT, 0.5)
        stream = library.streams["s"]
        server.stop()
        try:
            for _ in range(3):
                await library.look()
                assert library.streams.get("s") is stream
            # A waiting client does not wait longer than requested.
            began_s = now_s()
            await stream.wait_for_growth(10, 0.3)
            assert now_s() - began_s == pytest.approx(0.3)
        finally:
            server.start()
        server.delete("root/s")
        await library.look()
        assert library.streams == {}

    virtually(check())
    lines = [record.getMessage() for record in caplog.records if record.name == "server.library"]
    lines += [r.getMessage() for r in caplog.records if r.name == "server.library.library"]
    assert len(lines) == 2, lines
    assert "cannot be read" in lines[0]
    assert lines[1] == f"{ROOT} can be read again"


def test_a_bucket_that_is_not_there_is_an_error_at_the_start(server: S3Server) -> None:
    with pytest.raises(SwingsError, match="s3://absent/x/ cannot be read: NoSuchBucket"):
        Library("s3://absent/x", 0.5)
