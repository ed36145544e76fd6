"""Small streams, a server in this process, and a client for tests of the server."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Callable, Iterable, Mapping
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import aiohttp
import numpy as np
from yarl import URL

from codec.slice import Slice
from codec.stream import StreamWriter
from codec.stream.manifest import Manifest
from codec.stream.playrecord import KeyframeRecord, Record, RecordParser, SliceRecord
from server.library import Library
from server.listener import bind
from server.operate.log import EventLog, LogRequests, LogStyle
from server.operate.overload import OverloadConfig
from server.operate.workers import SupervisorConfig
from server.serving import RunningServer
from server.state.config import ServerConfig, TimeoutConfig
from server.state.serverstate import ServerState
from tests.support import hosted_streams
from tests.support.hosted_streams import random_splats
from tests.support.waiting import BOUND_S

SWIN_SIZE, SEGMENT_FRAMES = 4, hosted_streams.SEGMENT_FRAMES


def random_slice(birth: int, count: int) -> Slice:
    """A slice of noise, which zstd cannot compress."""
    return Slice(birth, random_splats(count, 0, birth + 1000), np.zeros(count, np.uint8))


def small_manifest(slice_size: int = 8, fps: float = 30.0, title: str = "") -> Manifest:
    changes = {"layers": (0.25,) * 4, "swin_size": SWIN_SIZE, "title": title}
    return hosted_streams.small_manifest(slice_size, 0, fps, **changes)


def births_of(num_frames: int) -> range:
    return range(1 - SWIN_SIZE, num_frames)


def make_stream(
    path: Path,
    num_frames: int,
    slice_size: int = 8,
    fps: float = 30.0,
    title: str = "",
    num_empty: int = 0,
) -> Path:
    """Writes a finished stream to `path`. num_empty: slots of a slice that have no Gaussian."""
    with StreamWriter.create(path, small_manifest(slice_size, fps, title), exact=True) as writer:
        for birth in births_of(num_frames):
            writer.append(random_slice(birth, slice_size - num_empty))
    return path


def live_stream(path: Path, num_frames: int = 0, fps: float = 30.0) -> StreamWriter:
    """A writer of an unfinished stream with `num_frames` frames."""
    writer = StreamWriter.create(path, small_manifest(fps=fps))
    if num_frames:
        append_frames(writer, num_frames)
    return writer


def append_frames(writer: StreamWriter, num_frames: int = SEGMENT_FRAMES) -> None:
    """Appends `num_frames` frames, with all slices before them."""
    for birth in range(writer.next_birth, max(writer.next_birth, 0) + num_frames):
        writer.append(random_slice(birth, 8))


def quick_config(
    *,
    max_lead_s: float = 2.0,
    max_plays: int = 8,
    write_timeout_s: float = BOUND_S,
    keepalive_timeout_s: float = BOUND_S,
    send_queue_bytes: int = 65536,
    live_idle_s: float = BOUND_S,
    cors_origin: str = "*",
) -> ServerConfig:
    """A config for tests, in which a slow machine ends nothing and is no load."""
    return ServerConfig(
        max_lead_s=max_lead_s,
        max_plays=max_plays,
        timeouts=TimeoutConfig(
            keepalive_timeout_s=keepalive_timeout_s,
            write_timeout_s=write_timeout_s,
        ),
        overload=OverloadConfig(smooth_s=1e6),
        supervisor=SupervisorConfig(shutdown_timeout_s=2.0),
        log_requests=LogRequests.ALL,
        send_queue_bytes=send_queue_bytes,
        refresh_s=0.02,
        live_idle_s=live_idle_s,
        cors_origin=cors_origin,
    )


class Lines(EventLog):
    """Keeps the fields of all events."""

    def __init__(self) -> None:
        super().__init__(2, LogStyle.JSON)
        self.kept: list[dict[str, object]] = []

    def event(self, event: str, level: str = "info", /, **fields: object) -> None:
        self.kept.append(fields)


@dataclass(frozen=True)
class Running:
    """A server on a real socket of this machine."""

    port: int
    state: ServerState
    server: RunningServer
    log: Lines
    """A line for each request."""

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}"


@asynccontextmanager
async def running(root: Path, config: ServerConfig | None = None) -> AsyncIterator[Running]:
    """Runs a server for `root` during the block."""
    config = config or quick_config()
    listener = bind("127.0.0.1", 0)
    state = ServerState(Library(root, config.refresh_s), config)
    log = Lines()
    server = RunningServer(state, log)
    await server.start(listener)
    try:
        yield Running(listener.getsockname()[1], state, server, log)
    finally:
        await server.stop()


def parse_records(pieces: Iterable[bytes]) -> list[Record]:
    """The records of a whole /play response."""
    parser = RecordParser()
    records = [record for piece in pieces for record in parser.feed(piece)]
    assert parser.pending_bytes == 0
    return records


async def play(client: aiohttp.ClientSession, stream: str, query: str = "") -> list[Record]:
    """Requests a play; returns its records."""
    async with client.get(f"/v1/streams/{stream}/play{query}") as response:
        assert response.status == 200, await response.text()
        assert response.content_type == "application/x-swings-play"
        assert response.headers["Cache-Control"] == "no-store"
        return parse_records([piece async for piece, _ in response.content.iter_chunks()])


def slices_of(records: Iterable[Record]) -> list[SliceRecord]:
    return [record for record in records if isinstance(record, SliceRecord)]


def births_with_layer_0(records: Iterable[Record]) -> list[int]:
    """Births in the order in which their layer 0 arrived, by a slice or by a keyframe."""
    firsts = (r for r in records if isinstance(r, SliceRecord | KeyframeRecord))
    return [
        one.birth if isinstance(one, SliceRecord) else one.frame
        for one in firsts
        if not one.first_layer
    ]


async def raw_get(port: int, path: str) -> tuple[bytes, bytes]:
    """Head and body of the response to a GET; `path` is sent without normalisation."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    try:
        head = f"GET {path} HTTP/1.1\r\nHost: x\r\nConnection: close\r\n\r\n"
        writer.write(head.encode("latin-1"))
        async with asyncio.timeout(BOUND_S):
            found, _, body = (await reader.read()).partition(b"\r\n\r\n")
        return found, body
    finally:
        writer.close()
        await writer.wait_closed()


async def eventually(condition: Callable[[], object]) -> None:
    """Waits until `condition` holds."""
    async with asyncio.timeout(BOUND_S):
        while not condition():  # noqa: ASYNC110
            await asyncio.sleep(0.005)  # sleeps: between two looks at a server in this process


@asynccontextmanager
async def served(
    root: Path, config: ServerConfig | None = None
) -> AsyncIterator[tuple[Running, aiohttp.ClientSession]]:
    """A server for `root`, and a client of it."""
    async with running(root, config) as server, aiohttp.ClientSession(server.url) as client:
        yield server, client


@dataclass(frozen=True)
class Answer:
    """A whole response."""

    status: int
    headers: Mapping[str, str]
    body: bytes

    @property
    def text(self) -> str:
        return self.body.decode()

    def json(self) -> Any:
        return json.loads(self.body)


async def fetch(
    client: aiohttp.ClientSession, url: str | URL, method: str = "GET", **fields: str
) -> Answer:
    """The response to a request. fields: its headers, with _ for -."""
    headers = {name.replace("_", "-"): value for name, value in fields.items()}
    async with client.request(method, url, headers=headers) as response:
        return Answer(response.status, response.headers, await response.read())
