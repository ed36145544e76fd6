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
from server.abr.policy import Situation

import server.play
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
from player.link.relay import Relay
from player.playback import play
from player.render.cpu import render_splats
from player.render.renderer import RendererKind
from player.show.sink import to_bytes
from player.source.fetch import Fetcher
from player.source.receiver import open_receiver
from server.abr.link.link import Link, LinkStep
from tests.support.hosted_streams import ServerProcess, served, static_host
from tests.support.running_server import Running, on_server, quick_config
from tests.support.running_server import play as play_records
from tests.support.slots.screen import Screen
from tests.support.slots.slot_streams import write_busy_stream
from tests.support.slots.updates import small_layout

NUM_FRAMES, LAYERS, FPS = 300, 3, 60.0
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
def served_library(library: Path) -> Iterator[ServerProcess]:
    with served(library) as process:
        yield process


def pictures(folder: Path) -> list[np.ndarray[tuple[int, ...], np.dtype[np.uint8]]]:
    return [np.asarray(Image.open(path)) for path in sorted(folder.iterdir())]


def test_pictures_are_those_of_the_stream_from_every_source(
    library: Path, served_library: ServerProcess, tmp_path: Path
) -> None:
    reader = StreamReader(library / "long")
    camera, frames = reader.manifest.camera(), FrameRange(22, 34)
    expected = [
        to_bytes(render_splats(reader.active_splats(f, 2), camera, reader.manifest.near_m))
        for f in range(22, 34)
    ]
    assert max(picture.max() for picture in expected) > 60
    with static_host(library) as host:
        sources = [str(library / "long"), f"{host}/long", f"{served_library.url}/watch/long"]
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


def check_records(reader: StreamReader, records: list[Record]) -> list[int]:
    """Plays a whole response of frame 0 onto a screen, which checks it; gives the layers of each
    slice."""
    start, *between, end = records
    assert isinstance(start, StartRecord)
    assert end == EndRecord(NUM_FRAMES)
    receiver = open_receiver("S", reader.manifest, LAYERS, FrameRange())
    screen, before, layers = Screen(reader, 0), 0, list[int]()
    for record in between:
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
    return layers


# A short lead and a short queue: the server learns soon what became of the link.
QUICK = quick_config(target_lead_s=0.8, send_queue_bytes=16 * 1024)


def test_over_a_link_that_dips_only_what_is_known_shows(library: Path) -> None:
    got = list[Record]()

    async def check(server: Running, client: aiohttp.ClientSession) -> None:
        got.extend(await asyncio.to_thread(received_over, DIP, server.url, server.port))

    on_server(library, check, QUICK)
    # How many layers there were is a matter of time, and of what else the machine does.
    check_records(StreamReader(library / "long"), got)


class Swaying:
    """Wants all layers in one second of media, one in the next."""

    def __init__(self) -> None:
        self._slices = 0

    def choose_layers(self, situation: Situation) -> int:
        self._slices += 1
        return 1 if self._slices // int(FPS) % 2 else LAYERS


def test_layers_go_at_once_and_come_back_with_a_segment(
    library: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(server.play, "LayerPolicy", Swaying)
    got = list[Record]()

    async def check(server: Running, client: aiohttp.ClientSession) -> None:
        got.extend(await play_records(client, "long"))

    on_server(library, check, QUICK)
    layers = check_records(StreamReader(library / "long"), got)
    changes = [birth for birth, (a, b) in enumerate(pairwise(layers), 2) if a != b]
    # The snapshots of frame 0 are the first choice.
    for number, birth in enumerate(changes):
        if number % 2:
            assert birth % LAYOUT.segment_frames == 1
        else:
            assert birth == 59 + 60 * number
    assert len(changes) >= 4


def test_a_whole_playback_over_a_link(
    library: Path, served_library: ServerProcess, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    config = PlayConfig(
        f"{served_library.url}/watch/long",
        capture=out,
        renderer=RendererKind.CPU,
        link=Link([LinkStep(1.0, 3e6, 0.005), LinkStep(1.0, 0.8e6, 0.005)]),
        frames=FrameRange(3, 240),
    )
    summary = play(config)
    assert summary.totals.frames == 237
    assert 1 <= summary.totals.mean_layers < LAYERS
    assert len(pictures(out)) == 237
    assert summary.link_bytes is not None
    assert summary.link_bytes >= summary.totals.wire_bytes > 0
