"""/play in virtual time: how fast it is sent to clients that take it at different rates."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import pytest
from multidict import CIMultiDict

from codec.stream.playrecord import (
    EndRecord,
    ErrorRecord,
    Record,
    RecordParser,
)
from server.abr.clientstatus import PLAY_HEADER, ClientStatus
from server.answers.call import Call
from server.answers.play import play
from server.exchange.request import Request
from server.exchange.response import StreamedResponse
from server.library import Library
from server.state.config import ServerConfig
from server.state.serverstate import ServerState
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


class Client:
    """Takes `rate` bytes a second, and all that a connection with little room holds."""

    cut = ""

    def __init__(self, rate: float) -> None:
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

    def __init__(self, state: ServerState, response: StreamedResponse, client: Client) -> None:
        self.state = state
        self.client = client
        self.task = asyncio.ensure_future(response.produce(client))
        self._token = response.fields[PLAY_HEADER]

    def report(self, status: ClientStatus) -> None:
        self.state.plays.report(self._token, "long", status)


async def began(root: Path, query: str, rate: float, config: ServerConfig) -> Played:
    state = ServerState(Library(root, 1.0), config)
    (name,) = state.library.streams
    path = f"/v1/streams/{name}/play"
    request = Request("GET", path, query, "h", CIMultiDict())
    response = await play(Call(state, request, "192.0.2.1", False, {"stream": name}))
    return Played(state, response, Client(rate))


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
