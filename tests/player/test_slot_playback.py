"""Streams of version 2 from end to end: pictures from every source, over links that change too."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import aiohttp
import numpy as np
import pytest
from PIL import Image

from codec.framerange import FrameRange
from codec.stream import StreamReader
from codec.stream.playrecord import (
    EndRecord,
    Record,
    RecordParser,
    SliceRecord,
    SnapshotRecord,
    StartRecord,
)
from player.config import PlayConfig
from player.link.link import Link, LinkStep
from player.link.relay import Relay
from player.playback import play
from player.render.cpu import render_splats
from player.render.renderer import RendererKind
from player.show.sink import to_bytes
from player.source.fetch import Fetcher
from player.source.receiver import open_receiver
from tests.support.hosted_streams import ServerProcess, served, static_host
from tests.support.running_server import Running, on_server, quick_config
from tests.support.slots.screen import Screen
from tests.support.slots.slot_streams import write_busy_stream
from tests.support.slots.updates import small_layout

NUM_FRAMES, LAYERS, FPS = 480, 3, 60.0
LAYOUT = small_layout(4, (120, 120, 120), 0, 15)
DIP = Link(
    [
        LinkStep(1.5, 8e6, 0.005),
        LinkStep(2.5, 0.5e6, 0.005),
        LinkStep(60.0, 8e6, 0.005),
    ]
)
"""All layers take some 1.5 Mbit/s, one about 0.5."""


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("library")
    write_busy_stream(root / "long", NUM_FRAMES, LAYOUT, fps=FPS)
    return root


@pytest.fixture(scope="module")
def server(library: Path) -> Iterator[ServerProcess]:
    with served(library) as server:
        yield server


def pictures(folder: Path) -> list[np.ndarray[tuple[int, ...], np.dtype[np.uint8]]]:
    return [np.asarray(Image.open(path)) for path in sorted(folder.iterdir())]


def test_pictures_are_those_of_the_stream_from_every_source(
    library: Path, server: ServerProcess, tmp_path: Path
) -> None:
    reader = StreamReader(library / "long")
    camera, frames = reader.manifest.camera(), FrameRange(22, 34)
    expected = [
        to_bytes(render_splats(reader.active_splats(f, 2), camera, reader.manifest.near_m))
        for f in range(22, 34)
    ]
    assert max(picture.max() for picture in expected) > 60
    with static_host(library) as host:
        sources = [str(library / "long"), f"{host}/long", f"{server.url}/watch/long"]
        for number, source in enumerate(sources):
            out = tmp_path / str(number)
            config = PlayConfig(
                source, capture=out, frames=frames, layers=2, renderer=RendererKind.CPU
            )
            summary = play(config)
            assert summary.totals.frames == 12
            assert summary.totals.mean_layers == 2
            got = pictures(out)
            assert len(got) == 12
            assert all(np.array_equal(a, b) for a, b in zip(got, expected, strict=True))


def received_over(link: Link, url: str, port: int) -> list[Record]:
    """All records of a play whose layers the server chooses."""
    with Relay(link, "127.0.0.1", port) as relay:
        fetcher, parser, records = Fetcher(relay.address), RecordParser(), list[Record]()
        response = fetcher.open(f"{url}/v1/streams/long/play")
        while piece := response.read():
            records += parser.feed(piece)
        response.close()
        fetcher.close()
    return records


def test_over_a_link_that_dips_layers_go_and_come_back(library: Path) -> None:
    reader, got = StreamReader(library / "long"), list[Record]()

    async def check(server: Running, client: aiohttp.ClientSession) -> None:
        got.extend(await asyncio.to_thread(received_over, DIP, server.url, server.port))

    # A short lead and a short queue: the server learns soon what became of the link.
    on_server(library, check, quick_config(target_lead_s=0.8, send_queue_bytes=16 * 1024))
    start, *records, end = got
    assert isinstance(start, StartRecord)
    assert end == EndRecord(NUM_FRAMES)
    receiver = open_receiver("S", reader.manifest, LAYERS, FrameRange())
    screen, before, layers = Screen(reader, 0), 0, list[int]()
    for record in records:
        if isinstance(record, SnapshotRecord):
            assert not list(receiver.take(record))
            screen.snapshots_came()
            held = record.first_layer + len(record.packets)
        else:
            assert isinstance(record, SliceRecord)
            held = len(record.packets)
            layers.append(held)
            assert held <= before
            for received in receiver.take(record):
                screen.put(received, before if received.slice.birth < record.birth else held)
        before = held
    assert screen.next_birth == receiver.next_birth == NUM_FRAMES
    dropped = [birth for birth, (a, b) in enumerate(pairwise(layers)) if b < a]
    assert dropped
    assert max(layers[: dropped[0]]) == LAYERS
    # What was dropped is taken up again when the link is as it was.
    assert max(layers[dropped[0] + 1 :]) == LAYERS


def test_a_whole_playback_over_a_link(library: Path, server: ServerProcess, tmp_path: Path) -> None:
    out = tmp_path / "out"
    config = PlayConfig(
        f"{server.url}/watch/long",
        capture=out,
        renderer=RendererKind.CPU,
        link=Link([LinkStep(1.0, 3e6, 0.005), LinkStep(1.0, 0.8e6, 0.005)]),
        frames=FrameRange(3, 300),
    )
    summary = play(config)
    assert summary.totals.frames == 297
    assert 1 <= summary.totals.mean_layers < LAYERS
    assert len(pictures(out)) == 297
    assert summary.link_bytes is not None
    assert summary.link_bytes >= summary.totals.wire_bytes > 0
