"""/play over real sockets: what arrives is what the directory holds, whoever reads how slowly."""

from __future__ import annotations

import asyncio
import socket
import time
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import aiohttp
import pytest
from hypothesis import given
from hypothesis import strategies as st

from codec.errors import CorruptError
from codec.stream import StreamReader, StreamWriter
from codec.stream.object import decode_packet, object_packets
from codec.stream.playrecord import (
    EndRecord,
    ErrorRecord,
    Record,
    RecordParser,
    SliceRecord,
    StartRecord,
)
from server.answers.playquery import parse_query
from server.http.errors import RequestError
from server.listener import UNSENT_BYTES
from server.operate.workers.supervisor import SupervisorConfig
from tests.support.server.running_server import (
    SEGMENT_FRAMES,
    SWIN_SIZE,
    Running,
    births_of,
    births_with_layer_0,
    eventually,
    make_stream,
    on_server,
    parse_records,
    play,
    quick_config,
    random_slice,
    slices_of,
    small_manifest,
)


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("root")
    make_stream(folder / "walk", 23, fps=300)
    # 240 frames in 4 s; 170 KB a second with one layer, 680 with all.
    make_stream(folder / "long", 240, slice_size=200, fps=60)
    make_stream(folder / "wide", 9, slice_size=10_000, fps=30)  # more than sockets hold
    return folder


def packets_on_disk(path: Path) -> dict[tuple[int, int], bytes]:
    """The compressed packet of each (birth, layer)."""
    reader = StreamReader(path)
    return {
        (birth, layer): packet
        for record in reader.records
        for layer in range(reader.manifest.num_layers)
        for birth, packet in object_packets(reader.read_object(record.segment, layer).data)
    }


@pytest.mark.parametrize(
    ("query", "from_frame", "until", "layers"),
    [
        ("?layers=4", 0, 23, 4),
        ("?layers=1", 0, 23, 1),
        ("", 0, 23, None),
        ("?from=0&layers=auto", 0, 23, None),
        ("?from=0&layers=all", 0, 23, 4),
        ("?from=11&layers=2", 11, 23, 2),
        ("?from=22&layers=3", 22, 23, 3),
        ("?from=5&paused=1&layers=2", 5, 23, 2),
        ("?from=4&until=9&layers=4", 4, 9, 4),
        ("?until=500&layers=2", 0, 23, 2),
    ],
)
def test_a_play_is_the_directory_slice_by_slice(
    root: Path, query: str, from_frame: int, until: int, layers: int | None
) -> None:
    disk = packets_on_disk(root / "walk")

    async def check(server: Running, client: aiohttp.ClientSession) -> None:
        start, *slices, end = await play(client, "walk", query)
        manifest = (root / "walk" / "manifest.json").read_bytes()
        assert start == StartRecord(from_frame, 23, manifest)
        assert end == EndRecord(23)
        births = range(from_frame - SWIN_SIZE + 1, until)
        assert births_with_layer_0(slices) == list(births)
        came = set()
        for one in slices_of(slices):
            assert layers in (None, len(one.packets))
            for layer, packet in enumerate(one.packets, one.first_layer):
                assert (one.birth, layer) not in came
                came.add((one.birth, layer))
                assert packet == disk[one.birth, layer]
                chunk = decode_packet(packet)
                assert (chunk.birth, chunk.layer) == (one.birth, layer)
        assert server.state.metrics.plays.value("complete") == 1

    on_server(root, check)


pairs = st.lists(
    st.tuples(
        st.sampled_from(["from", "until", "layers", "x"]),
        st.sampled_from(["auto", "all", "0", "1", "4", "5", "9", "10", "-1", "1.0", "٣", ""])
        | st.text(max_size=12),
    ),
    max_size=4,
)


@given(pairs)
def test_a_query_is_valid_or_a_400_in_one_short_line(items: list[tuple[str, str]]) -> None:
    try:
        query = parse_query(items, num_frames=10, live=False, num_layers=4)
    except RequestError as error:
        refused = error
    else:
        assert 0 <= query.from_frame < 10
        assert query.until_frame is None or query.until_frame > query.from_frame
        assert query.num_layers in (None, 1, 2, 3, 4)
        assert len(dict(items)) == len(items)
        return
    assert refused.status == 400
    assert len(str(refused)) < 200
    assert "\n" not in str(refused)


@pytest.mark.parametrize(
    "query",
    [
        "?from=23",
        "?from=-1",
        "?from=x",
        "?from=",
        "?from=1e3",
        "?from=99999999999",
        "?layers=0",
        "?layers=5",
        "?layers=every",
        "?until=0",
        "?from=5&until=5",
        "?from=1&from=2",
        "?speed=2",
    ],
)
def test_a_wrong_query_is_a_400(root: Path, query: str) -> None:
    async def check(server: Running, client: aiohttp.ClientSession) -> None:
        async with client.get(f"/v1/streams/walk/play{query}") as response:
            assert response.status == 400
            assert (await response.json())["error"]
        async with client.get(f"/v1/streams/nobody/play{query}") as response:
            assert response.status == 404
        assert len(server.state.plays) == 0

    on_server(root, check)


def test_a_live_stream_may_be_joined_empty_but_a_finished_one_not() -> None:
    assert parse_query([], 0, True, 4).from_frame == 0
    with pytest.raises(RequestError, match="has 0 frames"):
        parse_query([], 0, False, 4)
    with pytest.raises(RequestError, match="has 0 frames"):
        parse_query([("from", "1")], 0, True, 4)


@pytest.mark.realtime
def test_pacing_sends_no_more_than_the_lead(root: Path) -> None:
    async def check(server: Running, client: aiohttp.ClientSession) -> None:
        async with client.get("/v1/streams/long/play?layers=4") as response:
            parser, began_s, started_s = RecordParser(), time.monotonic(), 0.0
            async for piece in response.content.iter_any():
                now_s = time.monotonic()
                for record in parser.feed(piece):
                    if not isinstance(record, SliceRecord):
                        continue
                    if record.birth == 0:
                        started_s = now_s
                    if record.birth > 0:
                        # A tenth of a second for a machine that does something else.
                        lead_s = record.birth / 60 - (now_s - started_s)
                        assert lead_s <= 0.6 + 0.1
            assert time.monotonic() - began_s > 240 / 60 - 0.6 - 0.1

    on_server(root, check, quick_config(max_lead_s=0.6))


class SlowClient:
    """Reads a /play at `rate` bytes per second through a small receive buffer, in a thread."""

    def __init__(self, port: int, path: str, rate: float, header: str = "Host: x") -> None:
        self._socket = socket.socket()
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 16 * 1024)
        self._socket.settimeout(10)
        self._socket.connect(("127.0.0.1", port))
        # HTTP/1.0, so that no chunk heads stand between the records.
        self._socket.sendall(f"GET {path} HTTP/1.0\r\n{header}\r\n\r\n".encode())
        self._rate = rate

    def read(self) -> list[Record]:
        """All records, read at the given rate."""
        data = bytearray()
        began_s = time.monotonic()
        while piece := self._socket.recv(4096):
            data += piece
            time.sleep(max(0.0, began_s + len(data) / self._rate - time.monotonic()))
        self._socket.close()
        return parse_records([bytes(data[data.index(b"\r\n\r\n") + 4 :])])

    def read_a_little(self) -> None:
        assert self._socket.recv(2048)

    def close(self) -> None:
        self._socket.close()


def mean_layers(records: Iterable[Record]) -> float:
    shown = [one for one in slices_of(records) if one.birth > 0]
    return sum(len(one.packets) for one in shown) / len({one.birth for one in shown})


def test_a_slow_reader_gets_fewer_layers_than_a_fast_one(root: Path) -> None:
    async def check(server: Running, client: aiohttp.ClientSession) -> None:
        slow = SlowClient(server.port, "/v1/streams/long/play", rate=260_000)
        slow_records, fast_records = await asyncio.gather(
            asyncio.to_thread(slow.read), play(client, "long")
        )
        births = list(births_of(240))
        for records in (slow_records, fast_records):
            assert births_with_layer_0(records) == births
            assert records[-1] == EndRecord(240)
        assert mean_layers(fast_records) > 3.2
        assert 1.2 < mean_layers(slow_records) < 1.8

    on_server(root, check, quick_config(send_queue_bytes=16 * 1024))


@pytest.mark.parametrize(
    "path", ["/v1/streams/wide/play?layers=4", "/v1/streams/wide/segments/0/0"]
)
def test_a_reader_that_stops_is_cut(
    root: Path, path: str, caplog: pytest.LogCaptureFixture
) -> None:
    async def check(server: Running, client: aiohttp.ClientSession) -> None:
        stuck = SlowClient(server.port, path, rate=1)
        await asyncio.to_thread(stuck.read_a_little)
        metrics = server.state.metrics
        route = path.split("?")[0]
        route = route.replace("wide", "{stream}").replace("0/0", "{segment}/{layer}")
        # Another client is served meanwhile.
        assert slices_of(await play(client, "walk", "?layers=1"))
        await eventually(lambda: metrics.requests.value(route, "499"))
        assert metrics.timeouts.value("write") == 1
        await eventually(lambda: not len(server.state.plays))
        stuck.close()

    on_server(root, check, quick_config(write_timeout_s=1.0))
    assert not caplog.records


def test_bytes_left_in_buffers_do_not_hold_a_connection(root: Path) -> None:
    """A response that fits the buffers is over for the handler, but its bytes are still there."""
    route = "/v1/streams/{stream}/segments/{segment}/{layer}"

    async def check(server: Running, client: aiohttp.ClientSession) -> None:
        # More than the client and the kernel take, less than makes the handler wait.
        part = f"Range: bytes=0-{UNSENT_BYTES + 48 * 1024}"
        stuck = SlowClient(server.port, "/v1/streams/wide/segments/0/0", rate=1, header=part)
        await asyncio.to_thread(stuck.read_a_little)
        requests = server.state.metrics.requests
        await eventually(lambda: requests.value(route, "206") or requests.value(route, "499"))
        await eventually(lambda: not server.server.app.connections)
        stuck.close()

    on_server(root, check, quick_config(write_timeout_s=1.0, keepalive_timeout_s=0.3))


def test_one_play_more_is_asked_to_come_back(root: Path) -> None:
    async def check(server: Running, client: aiohttp.ClientSession) -> None:
        url = "/v1/streams/long/play?layers=1"
        async with client.get(url) as one, client.get(url) as two:
            assert (one.status, two.status) == (200, 200)
            async with client.get(url) as three:
                assert three.status == 503
                assert int(three.headers["Retry-After"]) > 0
                assert "2 plays" in (await three.json())["error"]
            assert server.state.metrics.active_plays.value() == 2
            one.close()
            await eventually(lambda: len(server.state.plays) == 1)
            async with client.get(url) as three:
                assert three.status == 200
                three.close()

    on_server(root, check, quick_config(max_plays=2))


def test_a_client_that_leaves_is_not_an_error(root: Path, caplog: pytest.LogCaptureFixture) -> None:
    async def check(server: Running, client: aiohttp.ClientSession) -> None:
        for path in (
            "/v1/streams/wide/play?layers=4",
            "/v1/streams/long/play",
            "/v1/streams/wide/segments/0/0",
        ):
            leaver = SlowClient(server.port, path, rate=1)
            await asyncio.to_thread(leaver.read_a_little)
            leaver.close()
        gone = server.state.metrics.plays
        await eventually(lambda: gone.value("gone") == 2 and not len(server.state.plays))

    on_server(root, check)
    assert not caplog.records


def test_many_clients_play_at_once(root: Path) -> None:
    disk = packets_on_disk(root / "walk")

    async def check(server: Running, client: aiohttp.ClientSession) -> None:
        async with asyncio.TaskGroup() as group:
            tasks = [
                group.create_task(play(client, "walk", f"?from={n % 20}&layers={n % 4 + 1}"))
                for n in range(40)
            ]
        for n, task in enumerate(tasks):
            for one in slices_of(task.result()):
                assert one.packets == tuple(disk[one.birth, k] for k in range(n % 4 + 1))
        assert server.state.metrics.plays.value("complete") == 40

    on_server(root, check, quick_config(max_plays=40))


def test_a_live_stream_is_followed_to_its_end(tmp_path: Path) -> None:
    writer = StreamWriter.create(tmp_path / "live", small_manifest())

    async def write() -> None:
        for birth in births_of(3 * SEGMENT_FRAMES + 2):
            writer.append(random_slice(birth, 8))
            await asyncio.sleep(0.02)
        writer.close()

    async def check(server: Running, client: aiohttp.ClientSession) -> None:
        records, _ = await asyncio.gather(play(client, "live"), write())
        assert isinstance(records[0], StartRecord)
        assert records[0].num_frames == 0
        births = list(births_of(3 * SEGMENT_FRAMES + 2))
        assert births_with_layer_0(records) == births
        assert records[-1] == EndRecord(3 * SEGMENT_FRAMES + 2)

    on_server(tmp_path, check)


def test_a_live_stream_without_news_lets_its_clients_go(tmp_path: Path) -> None:
    writer = StreamWriter.create(tmp_path / "live", small_manifest())
    for birth in births_of(SEGMENT_FRAMES):
        writer.append(random_slice(birth, 8))

    async def check(server: Running, client: aiohttp.ClientSession) -> None:
        last = (await play(client, "live"))[-1]
        assert isinstance(last, ErrorRecord)
        assert last.message.endswith(f"play again from frame {SEGMENT_FRAMES}")

    on_server(tmp_path, check, quick_config(live_idle_s=0.2))


def test_a_client_that_leaves_a_silent_live_stream_frees_its_place(tmp_path: Path) -> None:
    StreamWriter.create(tmp_path / "live", small_manifest())

    async def check(server: Running, client: aiohttp.ClientSession) -> None:
        async with client.get("/v1/streams/live/play") as response:
            assert response.status == 200
            assert len(server.state.plays) == 1
            response.close()
        await eventually(lambda: not len(server.state.plays))

    on_server(tmp_path, check, quick_config(live_idle_s=60))


def test_a_damaged_segment_ends_the_play_with_a_reason(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = make_stream(tmp_path / "s", 15) / "segments" / "1" / "1"
    path.write_bytes(path.read_bytes()[:-1] + b"x")

    async def check(server: Running, client: aiohttp.ClientSession) -> None:
        records = await play(client, "s", "?layers=2")
        assert [one.birth for one in slices_of(records)] == list(births_of(5))
        assert isinstance(records[-1], ErrorRecord)
        assert str(tmp_path) not in records[-1].message
        assert isinstance((await play(client, "s", "?layers=1"))[-1], EndRecord)
        assert server.state.metrics.plays.value("damaged") == 1

    on_server(tmp_path, check)
    assert str(path) in caplog.text


@pytest.mark.realtime
def test_stopping_ends_plays_at_a_slice_boundary(root: Path) -> None:
    async def check(server: Running, client: aiohttp.ClientSession) -> None:
        task = asyncio.create_task(play(client, "long", "?layers=2"))
        await eventually(lambda: server.state.metrics.packets.value("1"))
        began_s = time.monotonic()
        await server.server.stop()
        records = await task
        assert time.monotonic() - began_s < 1
        last = records[-1]
        assert isinstance(last, ErrorRecord)
        births = [one.birth for one in slices_of(records)]
        assert births == list(range(1 - SWIN_SIZE, births[-1] + 1))
        assert last.message.endswith(f"play again from frame {births[-1] + 1}")

    config = quick_config()
    on_server(root, check, replace(config, supervisor=SupervisorConfig(shutdown_timeout_s=5.0)))


def test_metrics_count_what_was_sent(root: Path) -> None:
    async def check(server: Running, client: aiohttp.ClientSession) -> None:
        records = slices_of(await play(client, "walk", "?layers=3"))
        metrics = server.state.metrics
        assert metrics.packets.value("2") == len(records)
        for layer in range(3):
            sent_bytes = sum(len(one.packets[layer]) for one in records)
            assert metrics.layer_bytes.value("play", str(layer)) == sent_bytes
        assert metrics.layer_bytes.value("play", "3") == 0

    on_server(root, check)


def test_a_truncated_play_is_noticed(root: Path) -> None:
    async def check(server: Running, client: aiohttp.ClientSession) -> None:
        async with client.get("/v1/streams/walk/play?layers=1") as response:
            data = await response.read()
        parser = RecordParser()
        parser.feed(data[:-1])
        assert parser.pending_bytes > 0
        with pytest.raises(CorruptError):
            RecordParser().feed(b"\xff\xff\xff\xff" + data)

    on_server(root, check)
