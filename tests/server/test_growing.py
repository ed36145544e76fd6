"""A stream that grows, or is replaced, and the clients that follow it."""

from __future__ import annotations

import asyncio
import shutil
from pathlib import Path

import aiohttp
import pytest
from aiohttp import web
from aiohttp.test_utils import make_mocked_request

from codec.stream import StreamReader
from codec.stream.playrecord import ErrorRecord, RecordParser, StartRecord
from server.answers.objects import index
from server.library import Library
from server.library.servedstream import LIVE_POLL_S
from server.state.config import ServerConfig
from server.state.serverstate import STATE, ServerState
from tests.support.server.running_server import (
    SEGMENT_FRAMES,
    append_frames,
    eventually,
    live_stream,
    make_stream,
    served,
)
from tests.support.server.virtualtime import in_virtual_time, now_s, passes

pytestmark = pytest.mark.anyio

INDEX = "/v1/streams/live/index.bin"


@in_virtual_time
async def test_who_waits_for_the_index_has_it_as_soon_as_it_grows(tmp_path: Path) -> None:
    writer = live_stream(tmp_path / "live", SEGMENT_FRAMES)
    # The default config of an operator, with its interval between looks.
    state = ServerState(Library(tmp_path, ServerConfig().refresh_s), ServerConfig())
    app = web.Application()
    app[STATE] = state

    async def wait(after: int, seconds: int) -> bytes:
        url = f"{INDEX}?after={after}&wait={seconds}"
        found = {"stream": "live"}
        response = await index(make_mocked_request("GET", url, app=app, match_info=found))
        assert isinstance(response, web.Response)
        assert response.status == 200
        assert isinstance(response.body, bytes)
        return response.body

    data = await wait(0, 0)
    assert await wait(len(data) - 1, 20) == data  # there is more already
    assert now_s() == 0
    waiting = [asyncio.create_task(wait(len(data), 20)) for _ in range(30)]
    await passes(0.7)
    assert not any(task.done() for task in waiting)
    append_frames(writer)
    grown_s = now_s()
    for found in await asyncio.gather(*waiting):
        assert (found[: len(data)], len(found)) == (data, 2 * len(data))
    assert now_s() - grown_s <= LIVE_POLL_S
    # No data arrives.
    began_s = now_s()
    assert len(await wait(2 * len(data), 1)) == 2 * len(data)
    assert now_s() - began_s == pytest.approx(1)
    # A finished stream is not waited for.
    last = asyncio.create_task(wait(2 * len(data), 20))
    await passes(0.2)
    writer.close()
    ended_s = now_s()
    await last
    await wait(2 * len(data), 20)
    assert now_s() - ended_s <= LIVE_POLL_S


@pytest.mark.parametrize(
    "query", ["after=-1", "after=x", "after=1e3", "wait=31", "wait=0.5", "wait=", "after=%D9%A1"]
)
async def test_what_is_not_a_number_is_refused(query: str, tmp_path: Path) -> None:
    make_stream(tmp_path / "live", 3)

    async with served(tmp_path) as (_, client), client.get(f"{INDEX}?{query}") as response:
        assert response.status == 400
        assert "is not a number" in (await response.json())["error"]


async def test_who_asks_for_what_is_live_begins_with_the_newest_segment(tmp_path: Path) -> None:
    writer = live_stream(tmp_path / "live", 3 * SEGMENT_FRAMES)

    async def start(client: aiohttp.ClientSession) -> StartRecord:
        parser = RecordParser()
        async with client.get("/v1/streams/live/play?from=live&layers=1") as response:
            assert response.status == 200
            while True:
                for record in parser.feed(await response.content.readany()):
                    assert isinstance(record, StartRecord)
                    return record

    async with served(tmp_path) as (server, client):
        records = StreamReader(tmp_path / "live").records
        assert (await start(client)).from_frame == records[-1].first_frame > 0
        stream = server.state.library.streams["live"]
        before = stream.view.num_segments
        append_frames(writer)
        await eventually(lambda: stream.view.num_segments > before)
        records = StreamReader(tmp_path / "live").records
        assert (await start(client)).from_frame == records[-1].first_frame


async def test_a_replaced_stream_ends_its_plays_and_no_tag_has_two_contents(tmp_path: Path) -> None:
    first = make_stream(tmp_path / "first", 120, fps=1)
    second = make_stream(tmp_path / "second", 120, slice_size=9, fps=1)
    root = tmp_path / "root"
    root.mkdir()
    shutil.copytree(first, root / "walk")
    path = "/v1/streams/walk/segments/0/0"

    async with served(root) as (server, client):
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

        async def play() -> list[object]:
            parser = RecordParser()
            records: list[object] = []
            async with client.get("/v1/streams/walk/play?layers=1") as response:
                async for piece in response.content.iter_any():
                    records += parser.feed(piece)
            return records

        looking, playing = asyncio.create_task(look()), asyncio.create_task(play())
        await eventually(lambda: seen and server.state.metrics.packets.value("0"))
        (root / "walk").rename(tmp_path / "away")
        shutil.copytree(second, tmp_path / "new")
        (tmp_path / "new").rename(root / "walk")
        records = await playing
        last = records[-1]
        assert isinstance(last, ErrorRecord)
        assert "replaced or removed; play again from frame" in last.message
        await eventually(lambda: len(seen) == 2)
        stopped.set()
        await looking
        assert set(seen.values()) == {
            (folder / "segments" / "0" / "0").read_bytes() for folder in (first, second)
        }
