"""A stream that grows, or is replaced, and the clients that follow it."""

from __future__ import annotations

import asyncio
import shutil
import time
from pathlib import Path

import aiohttp
import pytest

from codec.stream import StreamReader
from codec.stream.playrecord import ErrorRecord, RecordParser, StartRecord
from server.state.config import ServerConfig
from tests.support.server.running_server import (
    SEGMENT_FRAMES,
    Running,
    append_frames,
    eventually,
    live_stream,
    make_stream,
    on_server,
    running,
)

pytestmark = pytest.mark.realtime

INDEX = "/v1/streams/live/index.bin"


def test_who_waits_for_the_index_has_it_as_soon_as_it_grows(tmp_path: Path) -> None:
    async def check() -> None:
        writer = live_stream(tmp_path / "live", SEGMENT_FRAMES)
        # The default config of an operator, with its interval between looks.
        async with (
            running(tmp_path, ServerConfig()) as server,
            aiohttp.ClientSession(server.url) as client,
        ):
            data = await (await client.get(INDEX)).read()

            async def wait(after: int, seconds: int) -> tuple[bytes, float]:
                url = f"{INDEX}?after={after}&wait={seconds}"
                async with client.get(url) as response:
                    assert response.status == 200
                    return await response.read(), time.monotonic()

            # There is more data already.
            began_s = time.monotonic()
            assert (await wait(len(data) - 1, 20))[0] == data
            assert time.monotonic() - began_s < 0.3
            new = "/v1/streams/live/segments/1/0"
            assert (await client.get(new)).status == 404
            waiting = [asyncio.create_task(wait(len(data), 20)) for _ in range(30)]
            await asyncio.sleep(0.7)
            assert not any(task.done() for task in waiting)
            append_frames(writer)
            grown_s = time.monotonic()
            for task in waiting:
                found, at_s = await task
                assert (found[: len(data)], len(found)) == (data, 2 * len(data))
                assert at_s - grown_s < 0.3
            assert (await client.get(new)).status == 200
            # No data arrives.
            began_s = time.monotonic()
            found, at_s = await wait(2 * len(data), 1)
            assert len(found) == 2 * len(data)
            assert 0.9 < at_s - began_s < 2
            # A finished stream is not waited for.
            last = asyncio.create_task(wait(2 * len(data), 20))
            await asyncio.sleep(0.2)
            writer.close()
            await asyncio.wait_for(last, 3)
            async with client.get("/v1/streams/live/manifest.json") as response:
                assert (await response.json())["live"] is False
            began_s = time.monotonic()
            await wait(2 * len(data), 20)
            assert time.monotonic() - began_s < 0.3

    asyncio.run(check())


@pytest.mark.parametrize(
    "query", ["after=-1", "after=x", "after=1e3", "wait=31", "wait=0.5", "wait=", "after=%D9%A1"]
)
def test_what_is_not_a_number_is_refused(query: str, tmp_path: Path) -> None:
    make_stream(tmp_path / "live", 3)

    async def check(server: Running, client: aiohttp.ClientSession) -> None:
        async with client.get(f"{INDEX}?{query}") as response:
            assert response.status == 400
            assert "is not a number" in (await response.json())["error"]

    on_server(tmp_path, check)


def test_who_asks_for_what_is_live_begins_with_the_newest_segment(tmp_path: Path) -> None:
    writer = live_stream(tmp_path / "live", 3 * SEGMENT_FRAMES)

    async def start(client: aiohttp.ClientSession) -> StartRecord:
        parser = RecordParser()
        async with client.get("/v1/streams/live/play?from=live&layers=1") as response:
            assert response.status == 200
            while True:
                for record in parser.feed(await response.content.readany()):
                    assert isinstance(record, StartRecord)
                    return record

    async def check(server: Running, client: aiohttp.ClientSession) -> None:
        records = StreamReader(tmp_path / "live").records
        assert (await start(client)).from_frame == records[-1].first_frame > 0
        stream = server.state.library.streams["live"]
        before = stream.view.num_segments
        append_frames(writer)
        await eventually(lambda: stream.view.num_segments > before)
        records = StreamReader(tmp_path / "live").records
        assert (await start(client)).from_frame == records[-1].first_frame

    on_server(tmp_path, check)


def test_a_replaced_stream_ends_its_plays_and_no_tag_has_two_contents(tmp_path: Path) -> None:
    first = make_stream(tmp_path / "first", 600)
    second = make_stream(tmp_path / "second", 600, slice_size=9)
    root = tmp_path / "root"
    root.mkdir()
    shutil.copytree(first, root / "walk")
    path = "/v1/streams/walk/segments/0/0"

    async def check(server: Running, client: aiohttp.ClientSession) -> None:
        seen: dict[str, bytes] = {}
        stopped = asyncio.Event()

        async def look() -> None:
            while not stopped.is_set():
                async with client.get(path) as response:
                    body = await response.read()
                    if response.status == 200:
                        assert seen.setdefault(response.headers["ETag"], body) == body
                    else:
                        assert response.status in (404, 500, 503)
                await asyncio.sleep(0.002)

        async def play() -> list[object]:
            parser = RecordParser()
            records: list[object] = []
            async with client.get("/v1/streams/walk/play?layers=1") as response:
                async for piece in response.content.iter_any():
                    records += parser.feed(piece)
            return records

        looking, playing = asyncio.create_task(look()), asyncio.create_task(play())
        await asyncio.sleep(0.5)
        (root / "walk").rename(tmp_path / "away")
        shutil.copytree(second, tmp_path / "new")
        (tmp_path / "new").rename(root / "walk")
        records = await asyncio.wait_for(playing, 10)
        last = records[-1]
        assert isinstance(last, ErrorRecord)
        assert "replaced or removed; play again from frame" in last.message
        await eventually(lambda: len(seen) == 2)
        stopped.set()
        await looking
        assert set(seen.values()) == {
            (folder / "segments" / "0" / "0").read_bytes() for folder in (first, second)
        }

    on_server(root, check)
