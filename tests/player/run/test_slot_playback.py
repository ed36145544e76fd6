"""Streams of slots from end to end: pictures from every source, also over changing links."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from codec.framerange import FrameRange
from codec.stream import StreamReader
from player.config import PlayConfig
from player.render.cpu import render_splats
from player.render.renderer import RendererKind
from player.run.playback import play
from player.show.sink import to_bytes
from server.abr.link.link import Link, LinkStep
from tests.support.hosted_streams import served, static_host
from tests.support.slots.slot_streams import write_busy_stream
from tests.support.slots.updates import small_layout

NUM_FRAMES, LAYERS, FPS = 90, 3, 60.0
LAYOUT = small_layout(4, (120, 120, 120), 0, 15)


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("library")
    write_busy_stream(root / "long", NUM_FRAMES, LAYOUT, fps=FPS)
    return root


def pictures(folder: Path) -> list[np.ndarray[tuple[int, ...], np.dtype[np.uint8]]]:
    return [np.asarray(Image.open(path)) for path in sorted(folder.iterdir())]


def test_pictures_are_those_of_the_stream_from_every_source(library: Path, tmp_path: Path) -> None:
    reader = StreamReader(library / "long")
    camera, frames = reader.manifest.camera(), FrameRange(22, 34)
    expected = [
        to_bytes(render_splats(reader.active_splats(f, 2), camera, reader.manifest.near_m))
        for f in range(22, 34)
    ]
    assert max(picture.max() for picture in expected) > 60
    with static_host(library) as host, served(library) as server:
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


def test_a_whole_playback_over_a_link(library: Path, tmp_path: Path) -> None:
    with static_host(library) as host:
        config = PlayConfig(
            f"{host}/long",
            capture=tmp_path / "out",
            renderer=RendererKind.CPU,
            link=Link([LinkStep(1.0, 0.8e6, 0.005)]),
            frames=FrameRange(3, 90),
        )
        summary = play(config)
    assert summary.totals.frames == 87
    assert 1 <= summary.totals.mean_layers < LAYERS
    assert len(pictures(tmp_path / "out")) == 87
    assert summary.link_bytes is not None
    assert summary.link_bytes >= summary.totals.wire_bytes > 0
