"""/play in virtual time: how fast it is sent to clients that take it at different rates."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import cast

import pytest
from aiohttp import web
from aiohttp.test_utils import make_mocked_request

from codec.stream.playrecord import EndRecord, ErrorRecord, Record, RecordParser
from server.abr.clientstatus import (
    MAX_POINTS,
    PLAY_HEADER,
    REPORT_HEADER,
    ClientStatus,
    parse_report_s,
)
from server.answers.play import Play, asked_query
from server.http.content import StreamedResponse
from server.library import Library
from server.state.config import ServerConfig
from server.state.serverstate import STATE, ServerState
from tests.support.server.running_server import (
    births_with_layer_0,
    live_stream,
    make_stream,
    quick_config,
    slices_of,
)
from tests.support.server.virtualtime import in_virtual_time, now_s, passes

FPS, NUM_FRAMES = 60, 240


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """4 s of a stream; 170 KB a second with one layer, 680 with all."""
    folder = tmp_path_factory.mktemp("root")
    make_stream(folder / "long", NUM_FRAMES, slice_size=200, fps=FPS)
    return folder


@pytest.fixture(scope="module")
def thrice(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A stream of three times that length."""
    folder = tmp_path_factory.mktemp("thrice")
    make_stream(folder / "long", 3 * NUM_FRAMES, slice_size=200, fps=FPS)
    return folder


class Client:
    """Takes `rate` bytes a second, and all that a connection with little room holds."""

    cut = ""

    def __init__(self, rate: float) -> None:
        self.connection = self
        self._rate = rate
        self._room_bytes = 65_536
        self._parser = RecordParser()
        self._queued = 0.0
        self._last_s = now_s()
        self.records: list[tuple[float, Record]] = []
        """The records, and when the server wrote them."""

    def hold_at_most(self, queue_bytes: int) -> None:
        self._room_bytes = queue_bytes

    def queued_bytes(self) -> int:
        passed_s, self._last_s = now_s() - self._last_s, now_s()
        self._queued = max(0.0, self._queued - passed_s * self._rate)
        return round(self._queued)

    def tcp_info(self) -> None:
        return None

    async def write(self, data: bytes) -> None:
        self.records += [(now_s(), record) for record in self._parser.feed(data)]
        self._queued = self.queued_bytes() + len(data)
        while (over := self.queued_bytes() - self._room_bytes) > 0:
            await passes(over / self._rate)

    @property
    def births(self) -> list[int]:
        return births_with_layer_0(record for _, record in self.records)


class Played:
    """A play that has begun."""

    def __init__(self, state: ServerState, play: Play, client: Client) -> None:
        self.state = state
        self.client = client
        self.task = asyncio.ensure_future(play.run(cast(StreamedResponse, client)))
        self._token = play.headers[PLAY_HEADER]
        self._wanted = play.headers.get(REPORT_HEADER, "")

    @property
    def report_s(self) -> float:
        entry = self.state.plays.find(self._token, "long")
        return (entry and entry.report_s) or parse_report_s(self._wanted) or 1.0

    def report(self, status: ClientStatus) -> None:
        self.state.plays.report(self._token, "long", status)


class BehindProxy(Client):
    """What is sent to it is taken at once by something that hands it on at the rate."""

    def __init__(self, rate: float) -> None:
        super().__init__(rate)
        self._came: list[tuple[float, int]] = []  # when how many bytes have come
        self._sent = 0
        self.behind_bytes = 0.0
        """The most that the proxy held."""

    async def write(self, data: bytes) -> None:
        self.records += [(now_s(), record) for record in self._parser.feed(data)]
        for first in range(0, len(data), 4096):
            piece = min(4096, len(data) - first)
            self._sent += piece
            self._last_s = max(self._last_s, now_s()) + piece / self._rate
            self._came.append((self._last_s, self._sent))
        self.behind_bytes = max(self.behind_bytes, (self._last_s - now_s()) * self._rate)

    def queued_bytes(self) -> int:
        return 0

    async def report(self, played: Played) -> None:
        """Reports as the server wants it, with a clock of its own, for as long as it plays."""
        reported = 0
        while not played.task.done():
            await passes(played.report_s)
            came = sum(at_s <= now_s() for at_s, _ in self._came)
            points = [(round(1e3 * (50 + at_s)), n) for at_s, n in self._came[reported:came]]
            if came:
                frame = round((now_s() - self._came[0][0]) * FPS)
                played.report(ClientStatus(frame, received=tuple(points[-MAX_POINTS:])))
            reported = came


async def began(
    root: Path, query: str, rate: float | Client, config: ServerConfig, **fields: str
) -> Played:
    state = ServerState(Library(root, 1.0), config)
    (name,) = state.library.streams
    app = web.Application()
    app[STATE] = state
    request = make_mocked_request(
        "GET", f"/?{query}", headers=fields, app=app, match_info={"stream": name}
    )
    play = Play(request, asked_query(request))
    return Played(state, play, rate if isinstance(rate, Client) else Client(rate))


def mean_layers(records: Iterable[Record]) -> float:
    shown = slices_of(records)
    return sum(len(one.packets) for one in shown) / len({one.birth for one in shown})


@pytest.mark.parametrize(("rate", "least", "most"), [(1e8, 3.2, 4.0), (260_000, 1.2, 1.8)])
@in_virtual_time
async def test_a_slow_reader_gets_fewer_layers_than_a_fast_one(
    root: Path, rate: float, least: float, most: float
) -> None:
    played = await began(root, "", rate, quick_config(send_queue_bytes=16 * 1024))
    await played.task
    records = [record for _, record in played.client.records]
    assert played.client.births == list(range(NUM_FRAMES))
    assert records[-1] == EndRecord(NUM_FRAMES)
    assert least < mean_layers(records) <= most


@pytest.mark.parametrize(
    "fields", [{"X-Forwarded-For": "192.0.2.7"}, {"Via": "1.1 box"}, {}], ids=str
)
@in_virtual_time
async def test_what_a_proxy_has_taken_is_not_taken_for_the_link(
    thrice: Path, fields: dict[str, str]
) -> None:
    """The slow link of above: what the client says counts, not what left the server at once. A
    tunnel that adds no field to the request is known by that, once too much went into it."""
    client = BehindProxy(260_000)
    played = await began(thrice, "reports=1", client, quick_config(), **fields)
    reports = asyncio.ensure_future(client.report(played))
    await played.task
    await reports
    assert client.births == list(range(3 * NUM_FRAMES))
    if fields:
        shown = slices_of(record for _, record in client.records)
        assert 1.2 < mean_layers(one for one in shown if one.birth > 2 * NUM_FRAMES) <= 1.8
        assert client.behind_bytes < 100_000
    else:  # 5.4 MB, of all layers throughout, where no report is believed
        assert client.behind_bytes < 2_000_000


@in_virtual_time
async def test_a_paused_client_is_sent_its_lead_and_no_more(root: Path) -> None:
    lead_s = 0.6
    played = await began(root, "layers=1", 1e8, quick_config(max_lead_s=lead_s))
    client = played.client
    await passes(0.2)
    before = len(client.births)
    for _ in range(30):
        played.report(ClientStatus(10, paused=True))
        await passes(1)
    assert 10 < len(client.births) <= max(before, 10 + round(lead_s * FPS) + 1)
    before = len(client.births)
    played.report(ClientStatus(10))
    await passes(1)
    assert len(client.births) > before + FPS / 2
    await played.task
    assert played.state.metrics.plays.value("complete") == 1


@in_virtual_time
async def test_stopping_ends_plays_at_a_slice_boundary(root: Path) -> None:
    played = await began(root, "layers=2", 1e6, quick_config())
    await passes(1)
    stopped_s = now_s()
    played.state.stopping.set()
    await played.task
    assert now_s() - stopped_s < 1
    last, births = played.client.records[-1][1], played.client.births
    assert isinstance(last, ErrorRecord)
    assert births == list(range(births[-1] + 1))
    assert last.message.endswith(f"play again from frame {births[-1] + 1}")
    assert played.state.metrics.plays.value("stopped") == 1


@in_virtual_time
async def test_a_live_stream_without_new_frames_ends_its_plays(tmp_path: Path) -> None:
    live_stream(tmp_path / "live", 5)
    played = await began(tmp_path, "", 1e8, replace(quick_config(), live_idle_s=60))
    await played.task
    assert 60 <= now_s() < 65
    last = played.client.records[-1][1]
    assert isinstance(last, ErrorRecord)
    assert last.message.endswith("play again from frame 5")
    assert not len(played.state.plays)
