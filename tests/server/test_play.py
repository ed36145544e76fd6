"""/play over real sockets: the received data is that of the folder, at any speed of reading."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable, Iterator
from pathlib import Path

import pytest

from codec.stream import StreamReader
from codec.stream.manifest import SKIP_MAPS, Part, keyframe_part
from codec.stream.playrecord import (
    EndRecord,
    ErrorRecord,
    KeyframeRecord,
    Record,
    SliceRecord,
    StartRecord,
)
from tests.support.server.running_server import (
    SEGMENT_FRAMES,
    births_of,
    births_with_layer_0,
    eventually,
    live_stream,
    make_stream,
    play,
    quick_config,
    random_slice,
    served,
)
from tests.support.slots.slot_streams import write_slot_stream
from tests.support.slots.updates import small_layout
from tests.support.waiting import BOUND_S

pytestmark = pytest.mark.anyio

NUM_FRAMES = {"walk": 23, "slots": 13}


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("root")
    make_stream(folder / "walk", NUM_FRAMES["walk"], fps=300)
    layout = small_layout(3, (6, 4, 5), 0, SEGMENT_FRAMES)
    write_slot_stream(folder / "slots", NUM_FRAMES["slots"], layout, fps=300.0)
    # 240 frames in 4 s; 170 KB a second with one layer, 680 with all.
    make_stream(folder / "long", 240, slice_size=200, fps=60)
    make_stream(folder / "wide", 9, slice_size=10_000, fps=30)  # more than the sockets' buffers
    return folder


def packets_on_disk(path: Path) -> dict[tuple[int, Part], bytes]:
    """The packets of each birth and part, and those of the keyframes."""
    reader = StreamReader(path)
    layers = range(reader.manifest.num_layers)
    found: dict[tuple[int, Part], bytes] = {}
    for record in reader.records:
        first = record.first_frame
        for part in (SKIP_MAPS, *layers, *map(keyframe_part, layers)):
            held = reader.read_object(record.segment, part)
            last = first if part in map(keyframe_part, layers) else first + record.num_frames - 1
            found |= {(birth, part): held.packet(birth) for birth in range(first, last + 1)}
    return found


def packets_of(records: Iterable[Record]) -> Iterator[tuple[tuple[int, Part], bytes]]:
    """All received packets, each with its birth and part."""
    for one in records:
        if isinstance(one, KeyframeRecord):
            for layer, packet in enumerate(one.packets, one.first_layer):
                yield (one.frame, keyframe_part(layer)), packet
        elif isinstance(one, SliceRecord):
            if one.skip_map is not None:
                yield (one.birth, SKIP_MAPS), one.skip_map
            for layer, packet in enumerate(one.packets, one.first_layer):
                yield (one.birth, layer), packet


@pytest.mark.parametrize(
    ("stream", "query", "first", "until", "layers"),
    [
        ("walk", "?layers=4", 0, 23, 4),
        ("walk", "?layers=1", 0, 23, 1),
        ("walk", "", 0, 23, None),
        ("walk", "?from=0&layers=auto", 0, 23, None),
        ("walk", "?from=0&layers=all", 0, 23, 4),
        ("walk", "?from=11&layers=2", 11, 23, 2),
        ("walk", "?from=22&layers=3", 22, 23, 3),
        ("walk", "?from=5&paused=1&layers=2", 5, 23, 2),
        ("walk", "?from=4&until=9&layers=4", 4, 9, 4),
        ("walk", "?until=500&layers=2", 0, 23, 2),
        ("slots", "?layers=3", 0, 13, 3),
        ("slots", "?until=1&layers=2", 0, 1, 2),
        ("slots", "?from=4&until=5&layers=3", 4, 5, 3),
        ("slots", "?from=5&until=6&layers=1", 5, 6, 1),
        ("slots", "?from=7", 7, 13, None),
        ("slots", "?from=12&layers=2", 12, 13, 2),
    ],
)
async def test_a_play_is_the_folder_slice_by_slice(
    root: Path, stream: str, query: str, first: int, until: int, layers: int | None
) -> None:
    disk = packets_on_disk(root / stream)
    frame = first - first % SEGMENT_FRAMES

    async with served(root) as (server, client):
        start, *records, end = await play(client, stream, query)
        num_frames = NUM_FRAMES[stream]
        assert start == StartRecord(
            first, num_frames, (root / stream / "manifest.json").read_bytes()
        )
        assert end == EndRecord(num_frames)
        assert births_with_layer_0(records) == list(range(frame, until))
        came = list(packets_of(records))
        assert len(dict(came)) == len(came)  # no packet arrives twice
        assert dict(came).items() <= disk.items()
        if layers is not None:
            parts = (SKIP_MAPS, *range(layers))
            assert dict(came).keys() == {(frame, keyframe_part(n)) for n in range(layers)} | {
                (birth, part) for birth in range(frame + 1, until) for part in parts
            }
        metrics = server.state.metrics
        for part in (SKIP_MAPS, 0, 1, keyframe_part(0), keyframe_part(3)):
            sent = [len(packet) for (_, of), packet in came if of == part]
            assert metrics.packets.value(str(part)) == len(sent)
            assert metrics.layer_bytes.value("play", str(part)) == sum(sent)
        assert metrics.plays.value("complete") == 1


async def test_long_keyframes_come_in_several_records(
    root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    disk = packets_on_disk(root / "slots")
    packets = tuple(disk[5, keyframe_part(n)] for n in range(3))
    monkeypatch.setattr("server.answers.play.KEYFRAMES_BYTES", len(packets[0]) + 1)

    async with served(root) as (_, client):
        records = await play(client, "slots", "?from=5&until=6")
        assert records[1] == KeyframeRecord(5, 0, packets[:1])  # layer 0 is first
        records = await play(client, "slots", "?from=5&until=6&layers=3")
        assert records[1] == KeyframeRecord(5, 0, packets[:2])
        assert records[2] == KeyframeRecord(5, 2, packets[2:])


async def test_a_client_that_leaves_is_not_an_error(
    root: Path, caplog: pytest.LogCaptureFixture
) -> None:
    async with served(root) as (server, client):
        for path in (
            "/v1/streams/wide/play?layers=4",
            "/v1/streams/long/play",
            "/v1/streams/wide/segments/0/0",
        ):
            response = await client.get(path)
            assert await response.content.readany()
            response.close()
        gone = server.state.metrics.plays
        await eventually(lambda: gone.value("gone") == 2 and not len(server.state.plays))
    assert not caplog.records


async def test_a_live_stream_is_followed_to_its_end(tmp_path: Path) -> None:
    writer = live_stream(tmp_path / "live")

    async with served(tmp_path) as (server, client):
        playing = asyncio.ensure_future(play(client, "live"))
        await eventually(lambda: len(server.state.plays))
        stream = server.state.library.streams["live"]
        for birth in births_of(3 * SEGMENT_FRAMES + 2):
            writer.append(random_slice(birth, 8))
            while stream.num_frames < birth // SEGMENT_FRAMES * SEGMENT_FRAMES:
                await stream.wait_for_growth(stream.view.num_segments, BOUND_S)
        writer.close()
        records = await playing
        assert isinstance(records[0], StartRecord)
        assert records[0].num_frames == 0
        births = list(range(3 * SEGMENT_FRAMES + 2))
        assert births_with_layer_0(records) == births
        assert records[-1] == EndRecord(3 * SEGMENT_FRAMES + 2)


async def test_a_client_that_leaves_a_silent_live_stream_frees_its_place(tmp_path: Path) -> None:
    live_stream(tmp_path / "live")

    async with served(tmp_path, quick_config(live_idle_s=60)) as (server, client):
        async with client.get("/v1/streams/live/play") as response:
            assert response.status == 200
            assert len(server.state.plays) == 1
            response.close()
        await eventually(lambda: not len(server.state.plays))


@pytest.mark.parametrize(("part", "end"), [("skipmaps", 5), ("1", 5), ("keyframe-0", 15)])
async def test_a_damaged_object_ends_the_play_with_a_reason(
    tmp_path: Path, part: str, end: int, caplog: pytest.LogCaptureFixture
) -> None:
    path = make_stream(tmp_path / "s", 15) / "segments" / "1" / part
    path.write_bytes(path.read_bytes()[:-1] + b"x")

    async with served(tmp_path) as (server, client):
        records = await play(client, "s", "?layers=2")
        assert births_with_layer_0(records) == list(range(end))
        assert isinstance(records[-1], EndRecord if end == 15 else ErrorRecord)
        # A client that joins there needs it.
        last = (await play(client, "s", "?from=6&layers=2"))[-1]
        assert isinstance(last, ErrorRecord)
        assert str(tmp_path) not in last.message
        assert server.state.metrics.plays.value("damaged") == 1 + (end < 15)
        if part == "1":
            assert isinstance((await play(client, "s", "?layers=1"))[-1], EndRecord)
    assert str(path) in caplog.text
