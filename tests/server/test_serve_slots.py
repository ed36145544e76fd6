"""Streams of version 2 over real sockets: what arrives is what the folder holds."""

from __future__ import annotations

import asyncio
import hashlib
import json
import re
from pathlib import Path

import aiohttp
import pytest

import server.answers.play
from codec.stream import StreamReader, StreamWriter
from codec.stream.manifest import MASKS, Part, snapshot_part
from codec.stream.playrecord import (
    EndRecord,
    ErrorRecord,
    SliceRecord,
    SnapshotRecord,
    StartRecord,
)
from server.library import Library
from tests.support.server.running_server import (
    Running,
    make_stream,
    on_server,
    play,
    quick_config,
    raw_request,
)
from tests.support.slots.slot_streams import slot_manifest, write_slot_stream
from tests.support.slots.updates import patternless_updates, small_layout

NUM_FRAMES, SEGMENT_FRAMES = 13, 5
LAYOUT = small_layout(3, (6, 4, 5), 0, SEGMENT_FRAMES)


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("root")
    write_slot_stream(folder / "slots", NUM_FRAMES, LAYOUT, fps=300.0)
    make_stream(folder / "whole", 3)
    return folder


def packet(reader: StreamReader, birth: int, part: Part) -> bytes:
    return reader.read_object(reader.manifest.segment_of(birth), part).packet(birth)


def test_every_file_is_served_as_it_lies_on_disk(root: Path) -> None:
    folder = root / "slots"
    names = {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}
    parts = {"0", "1", "2", "masks", "snapshot-0", "snapshot-1", "snapshot-2"}
    objects = {f"segments/{n}/{part}" for n in range(3) for part in parts}
    assert names == objects | {"manifest.json", "index.bin"}

    async def check(server: Running, client: aiohttp.ClientSession) -> None:
        for name in sorted(names):
            data, url = (folder / name).read_bytes(), f"/v1/streams/slots/{name}"
            async with client.get(url) as response:
                assert await response.read() == data
                tag = response.headers["ETag"]
                assert response.headers["Access-Control-Allow-Origin"] == "*"
            immutable = "immutable" in response.headers["Cache-Control"]
            assert immutable == (name in objects)
            if name in objects:
                assert tag == f'"{hashlib.sha256(data).hexdigest()}"'
            async with client.get(url, headers={"If-None-Match": tag}) as response:
                assert response.status == 304
            async with client.get(url, headers={"Range": "bytes=3-20"}) as response:
                assert (response.status, await response.read()) == (206, data[3:21])
            async with client.head(url) as response:
                assert response.headers["Content-Length"] == str(len(data))
        # Each name is one label, and there are no others.
        assert (
            set(re.findall(r'layer_bytes_total{layer="([^"]+)"', server.state.metrics.text()))
            == parts
        )

    on_server(root, check)


@pytest.mark.parametrize(
    "path",
    [
        "slots/segments/3/masks",
        "slots/segments/0/3",
        "slots/segments/0/snapshot-3",
        "slots/segments/0/snapshot-00",
        "slots/segments/0/snapshot-",
        "slots/segments/0/snapshot-999999999",
        "slots/segments/0/snapshot-%D9%A1",
        "slots/segments/0/snapshot",
        "slots/segments/0/mask",
        "slots/segments/0/masks0",
        "slots/segments/0/Masks",
        "slots/segments/masks/0",
        "whole/segments/0/masks",
        "whole/segments/0/snapshot-0",
    ],
)
def test_what_is_not_there_is_a_404_in_one_line_of_json(root: Path, path: str) -> None:
    async def check(server: Running, client: aiohttp.ClientSession) -> None:
        request = f"GET /v1/streams/{path} HTTP/1.1\r\nHost: x\r\nConnection: close\r\n\r\n"
        answer = await raw_request(server.port, request.encode())
        head, _, body = answer.partition(b"\r\n\r\n")
        assert head.startswith(b"HTTP/1.1 404 "), head
        assert "\n" not in json.loads(body)["error"]
        assert "layer_bytes_total{" not in server.state.metrics.text()

    on_server(root, check)


@pytest.mark.parametrize("layers", [1, 2, 3])
@pytest.mark.parametrize(
    ("first", "until"), [(0, 13), (0, 1), (4, 5), (5, 6), (5, 13), (7, 12), (12, 13)]
)
def test_a_play_is_the_folder_slice_by_slice(
    root: Path, first: int, until: int, layers: int
) -> None:
    reader = StreamReader(root / "slots")

    async def check(server: Running, client: aiohttp.ClientSession) -> None:
        query = f"?from={first}&until={until}&layers={layers}"
        start, snapshot, *slices, end = await play(client, "slots", query)
        assert start == StartRecord(first, NUM_FRAMES, reader.manifest_json)
        assert end == EndRecord(NUM_FRAMES)
        frame = first // SEGMENT_FRAMES * SEGMENT_FRAMES
        snapshots = tuple(packet(reader, frame, snapshot_part(n)) for n in range(layers))
        assert snapshot == SnapshotRecord(frame, 0, snapshots)
        assert slices == [
            SliceRecord(
                birth,
                tuple(packet(reader, birth, n) for n in range(layers)),
                packet(reader, birth, MASKS),
            )
            for birth in range(frame + 1, until)
        ]
        metrics = server.state.metrics
        for name, size in (
            ("0", sum(len(one.packets[0]) for one in slices if isinstance(one, SliceRecord))),
            ("masks", sum(len(one.mask or b"") for one in slices if isinstance(one, SliceRecord))),
            ("snapshot-0", len(snapshots[0])),
            ("snapshot-3", 0),
        ):
            assert metrics.layer_bytes.value("play", name) == size
        assert metrics.packets.value("0") == metrics.packets.value("masks") == len(slices)

    on_server(root, check)


def test_long_snapshots_come_in_several_records(
    root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    reader = StreamReader(root / "slots")
    packets = [packet(reader, 5, snapshot_part(n)) for n in range(3)]
    monkeypatch.setattr(server.answers.play, "SNAPSHOTS_BYTES", len(packets[0]) + 1)

    async def check(server: Running, client: aiohttp.ClientSession) -> None:
        records = await play(client, "slots", "?from=5&until=6")
        # Layer 0 comes first.
        assert records[1] == SnapshotRecord(5, 0, (packets[0],))
        records = await play(client, "slots", "?from=5&until=6&layers=3")
        assert records[1] == SnapshotRecord(5, 0, tuple(packets[:2]))
        assert records[2] == SnapshotRecord(5, 2, (packets[2],))

    on_server(root, check)


def test_a_live_stream_is_followed_to_its_end(tmp_path: Path) -> None:
    writer = StreamWriter.create(tmp_path / "live", slot_manifest(LAYOUT, live=True))

    async def write() -> None:
        for update in patternless_updates(LAYOUT, NUM_FRAMES):
            writer.append(update)
            await asyncio.sleep(0.02)
        writer.close()

    async def check(server: Running, client: aiohttp.ClientSession) -> None:
        records, _ = await asyncio.gather(play(client, "live", "?layers=2"), write())
        start, snapshot, *slices, end = records
        assert isinstance(start, StartRecord)
        assert start.num_frames == 0
        assert isinstance(snapshot, SnapshotRecord)
        assert [one.birth for one in slices if isinstance(one, SliceRecord)] == [*range(1, 13)]
        assert end == EndRecord(NUM_FRAMES)

    on_server(tmp_path, check)


@pytest.mark.parametrize(("part", "next_frame"), [("masks", 5), ("1", 5), ("snapshot-0", None)])
def test_a_damaged_object_ends_the_play_with_a_reason(
    tmp_path: Path, part: str, next_frame: int | None, caplog: pytest.LogCaptureFixture
) -> None:
    path = write_slot_stream(tmp_path / "s", 13, LAYOUT, fps=300.0) / "segments" / "1" / part
    path.write_bytes(path.read_bytes()[:-1] + b"x")

    async def check(server: Running, client: aiohttp.ClientSession) -> None:
        records = await play(client, "s", "?layers=3")
        births = [one.birth for one in records if isinstance(one, SliceRecord)]
        assert births == list(range(1, next_frame or 13))
        assert isinstance(records[-1], EndRecord if next_frame is None else ErrorRecord)
        # Who joins there needs it.
        assert isinstance((await play(client, "s", "?from=6&layers=3"))[-1], ErrorRecord)

    on_server(tmp_path, check)
    assert str(path) in caplog.text


def test_a_live_stream_without_news_says_where_to_go_on(tmp_path: Path) -> None:
    writer = StreamWriter.create(tmp_path / "live", slot_manifest(LAYOUT, live=True))
    for update in patternless_updates(LAYOUT, SEGMENT_FRAMES):
        writer.append(update)

    async def check(server: Running, client: aiohttp.ClientSession) -> None:
        for first in (0, 3, 4):
            last = (await play(client, "live", f"?from={first}"))[-1]
            assert isinstance(last, ErrorRecord)
            assert last.message.endswith(f"play again from frame {SEGMENT_FRAMES}")

    on_server(tmp_path, check, quick_config(live_idle_s=0.2))


def test_what_slices_and_snapshots_take(root: Path) -> None:
    stream = Library(root, 1.0).streams["slots"]
    reader = StreamReader(root / "slots")
    for birth, segment, count in ((0, 0, 5), (7, 1, 5), (12, 2, 3)):
        sizes = stream.sizes(birth)
        totals = [len(reader.read_object(segment, part).data) for part in (MASKS, 0, 1, 2)]
        assert sizes.slice_bytes[0] == pytest.approx((totals[0] + totals[1]) / count)
        assert sizes.slice_bytes[2] == pytest.approx(sum(totals) / count)
        snapshots = [len(reader.read_object(segment, snapshot_part(n)).data) for n in range(3)]
        assert sizes.snapshot_bytes == tuple(snapshots)
        assert list(sizes.psnr_db) == sorted(sizes.psnr_db)
        assert all(0 < share <= 1 for share in sizes.changed_shares)
