"""Seeks over an emulated link: time until the frame shows, and until a frame shows with all layers.

Usage: scripts/bench seek [--stream PATH] [--link 50M,20ms]
"""

from __future__ import annotations

import random
import tempfile
import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated
from urllib.parse import urlsplit

import numpy as np
from rich.console import Console
from rich.table import Table

from bench.serve.processes import serving
from codec.console import option, run_command
from codec.errors import SwingsError
from codec.framerange import FrameRange
from codec.stream import StreamReader, StreamWriter
from codec.stream.manifest import MANIFEST_NAME
from player.link.linkprocess import LinkProcess
from player.link.relay import read_link
from player.playout.clock import Clock
from player.playout.conductor import Conductor
from player.playout.queues import Events
from player.playout.timeline import FrameRecord, Playout
from player.render.gl import create_renderer
from player.render.renderer import Renderer, RendererKind
from player.source.opener import Opener
from player.source.source import Source
from player.view.path import Size, camera_path
from server.abr.link import Link
from tests.support.hosted_streams import static_host
from tests.support.slots.slot_streams import slot_manifest
from tests.support.slots.trained_updates import trained_like_layout, trained_like_updates

SWIN_SIZE, SEGMENT_FRAMES = 5, 30
PATIENCE_S = 20.0
LINK = "50M,20ms"
SIZE = Size(640, 360)
"""Size of the picture that is drawn before a seek counts as done."""


@dataclass(frozen=True, slots=True)
class SeekConfig:
    """Seeks to random frames while a stream plays over a slow link: from a server, and from
    static hosts."""

    stream: Path | None = None
    """A stream to play; by default a synthetic stream that resembles a trained stream."""
    link: Annotated[Link, option("RATE|TRACE", read_link)] = field(
        default_factory=lambda: read_link(LINK)
    )
    """The link, as for swings-play."""
    seeks: int = 30
    """Number of seeks."""
    num_gs: int = 40_000
    """Gaussians of the synthetic stream."""
    active: float = 0.3
    """Share of the slots that a slice of the synthetic stream changes."""
    num_frames: int = 300
    """Frames of the synthetic stream."""
    renderer: RendererKind = RendererKind.AUTO
    """Renderer of the player."""


@dataclass(frozen=True, slots=True)
class Seek:
    """Times of one seek, seconds from the call on."""

    base_s: float
    """Time until the frame is drawn, with any number of layers."""
    full_s: float
    """Time until a frame is drawn with all layers."""


def make_stream(path: Path, config: SeekConfig) -> None:
    layout = trained_like_layout(config.num_gs // SWIN_SIZE, SWIN_SIZE, SEGMENT_FRAMES)
    layers = tuple(count / layout.num_slots for count in layout.slots)
    with StreamWriter.create(path, slot_manifest(layout, layers=layers)) as writer:
        for update in trained_like_updates(layout, config.num_frames, config.active):
            writer.append(update)


def measure(config: SeekConfig, url: str) -> list[Seek]:
    link = LinkProcess(config.link, "127.0.0.1", urlsplit(url).port or 80)
    clock = Clock(real=True)
    rng = random.Random(0)
    with link as relay, closing(Opener(url, relay.address)) as opener:

        def open_at(frame: int) -> Source:
            return opener.open(FrameRange(frame), None, adaptive=True)

        def events(source: Source, play: int, not_before_s: float) -> Events:
            frames = source.frames
            playout = Playout(
                source.manifest, frames.first, frames.end, not_before_s=not_before_s, play=play
            )
            return Events(playout, clock)

        with Conductor(open_at, events, clock, interrupt=opener.interrupt) as conductor:
            manifest = conductor.source.manifest
            path = camera_path("default", manifest, SIZE, conductor.source.frames)
            with closing(create_renderer(config.renderer, manifest)) as renderer:
                conductor.attach(renderer)

                def drawn(is_enough: Callable[[FrameRecord], bool]) -> FrameRecord:
                    return draw_until(conductor, renderer, path, is_enough)

                drawn(lambda record: record.layers > manifest.num_layers - 0.01)
                seeks = []
                for _ in range(config.seeks):
                    time.sleep(rng.uniform(0.2, 0.5))
                    frame = rng.randrange(conductor.transport.last_frame - round(manifest.fps))
                    began_s = time.monotonic()
                    conductor.seek(frame)
                    first = drawn(lambda _: True)
                    base_s = time.monotonic() - began_s
                    if first.frame != frame:
                        raise SwingsError(f"a seek to {frame} showed {first.frame}")
                    drawn(lambda record: record.layers > manifest.num_layers - 0.01)
                    seeks.append(Seek(base_s, time.monotonic() - began_s))
                return seeks


def draw_until(
    conductor: Conductor,
    renderer: Renderer,
    path: Callable[[int], object],
    is_enough: Callable[[FrameRecord], bool],
) -> FrameRecord:
    """Draws the newest frames until `is_enough` accepts one; returns the first polled record."""
    until_s, first = time.monotonic() + PATIENCE_S, None
    while time.monotonic() < until_s:
        records = conductor.poll()
        if not records:
            time.sleep(0.001)
            continue
        first = first or records[0]
        renderer.render_again(records[-1].frame, path(records[-1].frame))  # type: ignore[arg-type]
        if is_enough(records[-1]):
            return first
    raise SwingsError(f"a seek did not end within {PATIENCE_S:.0f} s")


def run(config: SeekConfig) -> None:
    with tempfile.TemporaryDirectory() as folder:
        stream = config.stream or Path(folder) / "stream"
        if config.stream is None:
            make_stream(stream, config)
        reader = StreamReader(stream)
        num_bytes = sum(sum(record.part_bytes) for record in reader.records)
        with (
            serving(stream, "--log", "json", log=Path(folder) / "log") as (_, port),
            static_host(stream) as plain_url,
        ):
            url = f"http://127.0.0.1:{port}"
            hosts = {
                "a server": url,
                "a static host": f"{url}/v1/streams/{stream.name}/{MANIFEST_NAME}",
                "a host without ranges": plain_url,
            }
            found = {name: measure(config, url) for name, url in hosts.items()}
    manifest = reader.manifest
    table = Table("from", "seconds", "p50", "p90", "max")
    for host, seeks in found.items():
        for name, values in (
            ("to the frame, as it first shows", [one.base_s for one in seeks]),
            ("to all layers", [one.full_s for one in seeks]),
        ):
            cells = np.percentile(values, (50, 90, 100))
            table.add_row(host, name, *(f"{cell:.3f}" for cell in cells))
    console = Console()
    console.print(table)
    console.print(
        f"{config.seeks} seeks each, {manifest.num_gs} Gaussians, {manifest.num_layers} layers, "
        f"{num_bytes / reader.num_frames / 1e3:.1f} kB a frame"
    )


def main() -> None:
    run_command(SeekConfig, run, "seek", "Measures seeks over an emulated link.")


if __name__ == "__main__":
    main()
