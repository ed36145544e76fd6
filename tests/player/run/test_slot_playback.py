"""Streams of slots from end to end: pictures from every source, also over changing links."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from codec.framerange import FrameRange
from codec.stream import StreamReader
from player.config import PlayConfig
from player.link.linkprocess import LinkProcess
from player.render.cpu import render_splats
from player.render.renderer import RendererKind
from player.run.playback import play
from player.show.sink import to_bytes
from player.source.opener import opened
from server.abr.link.link import Link, LinkStep
from tests.support.delivery.assembled import assembled
from tests.support.hosted_streams import ServerProcess, served, static_host
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
"""All layers need about 1.5 Mbit/s, one layer about 0.5."""


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


def test_layers_come_and_go_over_a_link_and_only_what_is_known_shows(
    library: Path, served_library: ServerProcess
) -> None:
    reader = StreamReader(library / "long")
    with LinkProcess(DIP, "127.0.0.1", served_library.port) as relay:
        url = f"{served_library.url}/watch/long"
        screen, layers = Screen(reader, 0), list[float]()
        with opened(url, via=relay.address, adaptive=True) as source:
            assert source.adaptive
            for one in assembled(source):
                # As if each frame showed as soon as possible; later data repairs it.
                layers.append(one.layers)
                screen.put(one.slices, round(one.layers))
    assert screen.next_frame == NUM_FRAMES
    assert len(layers) == NUM_FRAMES


@contextmanager
def some_server(library: Path, kind: str) -> Iterator[str]:
    """The URL of the stream on a server, or on a static host."""
    if kind == "served":
        with served(library) as process:
            yield f"{process.url}/watch/long"
    else:
        with static_host(library) as host:
            yield f"{host}/long"


@pytest.mark.parametrize("kind", ["served", "hosted"])
def test_a_whole_playback_over_a_link(library: Path, tmp_path: Path, kind: str) -> None:
    out = tmp_path / "out"
    with some_server(library, kind) as url:
        config = PlayConfig(
            url,
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


def test_files_get_all_layers_from_a_static_host_and_the_cache_is_counted(
    library: Path, tmp_path: Path
) -> None:
    with static_host(library) as host:
        for hits in (False, True):
            config = PlayConfig(
                f"{host}/long",
                capture=tmp_path / str(hits),
                renderer=RendererKind.CPU,
                frames=FrameRange(16, 20),
                cache=tmp_path / "cache",
            )
            summary = play(config)
            assert summary.totals.mean_layers == LAYERS
            counted = summary.to_json()["cache"]
            assert bool(counted["hits"]) is hits
            assert bool(counted["misses"]) is not hits
