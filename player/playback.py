"""One playback from its options to its end: opens everything, runs the threads, sums up."""

from __future__ import annotations

import sys
from collections.abc import Callable
from contextlib import ExitStack, closing
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
import numpy.typing as npt
from rich.console import Console
from rich.progress import MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from codec.errors import InvalidError
from player.link.relay import Relay
from player.playout.clock import Clock
from player.playout.queues import Events
from player.playout.threads import Threads, render_thread
from player.playout.timeline import FrameRecord, Playout, QueueConfig
from player.render.renderer import Renderer, RendererKind, create_renderer
from player.show.sink import open_sink, to_bytes
from player.source.locate import open_source
from player.source.source import Source
from player.view.path import CameraPath, Size
from server.abr.link.link import Link

from .config import PlayConfig
from .report import PlaySummary, write_report

Floats = npt.NDArray[np.float32]

CAPTURE_QUEUE = QueueConfig(max_frames=1 << 30)
"""A capture's queue is bounded in bytes only. A full queue stops the reading, which a server takes
for a slow link; a machine that draws slowly should get there as late as possible."""


def play(config: PlayConfig) -> PlaySummary:
    """Plays the stream to its end, or until the window is closed."""
    clock = Clock(real=True)
    records: list[FrameRecord] = []
    keep: Callable[[FrameRecord], None] = records.append if config.report else lambda _: None
    with ExitStack() as stack:
        if config.capture is None:
            # Finds and loads the system's library for windows, which a capture does without.
            from player.show.window import show_window, window_system

            stack.enter_context(window_system())
        relay = None
        if config.link is not None:
            relay = stack.enter_context(_relay(config.link, config.source))
        via = relay.address if relay is not None else None
        source = open_source(config.source, config.frames, config.layers, via)
        stack.callback(source.close)
        path = config.camera.of(source.manifest, config.size, source.frames)
        # What a server chooses for a frame is known when the frame is due, and not before.
        clock.real = config.capture is None or source.adaptive
        events = Events(_playout(config, source), clock)
        if config.capture is None:
            renderer: Renderer = show_window(path, source, events, keep)
        else:
            renderer = _capture(config.capture, config.renderer, path, source, events, keep)
        summary = PlaySummary(
            source.name,
            renderer.name,
            events.totals,
            source.received_bytes,
            renderer.uploaded_bytes,
            relay.down_bytes if relay is not None else None,
            records,
        )
    if config.report is not None:
        write_report(config.report, summary)
    return summary


def _relay(link: Link, url: str) -> Relay:
    """A relay to the host of `url`."""
    parts = urlsplit(url)
    if not parts.hostname:
        raise InvalidError(f"{url} is not a URL: it names no host")
    try:
        return Relay(link, parts.hostname, parts.port or 80)
    except ValueError as error:  # urlsplit leaves the port unchecked until it is asked for
        raise InvalidError(f"{url} is not a URL: {error}") from error


def _playout(config: PlayConfig, source: Source) -> Playout:
    queue = QueueConfig() if config.capture is None else CAPTURE_QUEUE
    # Who has said how many layers to show gets them.
    needed = 1 if source.adaptive else source.num_layers
    return Playout(source.manifest, source.frames.first, source.frames.end, queue, needed=needed)


def _capture(
    output: Path,
    kind: RendererKind,
    path: CameraPath,
    source: Source,
    events: Events,
    keep: Callable[[FrameRecord], None],
) -> Renderer:
    """Draws every frame into files; gives the renderer, closed, for its name and counters."""
    first = path(source.frames.first)
    size = Size(first.width_px, first.height_px)
    with (
        Threads(source, events) as threads,
        closing(create_renderer(kind, source.manifest)) as renderer,
        open_sink(output, source.manifest.fps, size) as sink,
        _progress() as progress,
    ):
        task = progress.add_task("drawing", total=source.frames.count)

        def show(record: FrameRecord, picture: Floats) -> None:
            sink.write(record.frame, to_bytes(picture))
            keep(record)
            progress.advance(task)

        render_thread(threads.update(renderer), renderer, path, show)
    return renderer


def _progress() -> Progress:
    """A bar on stderr, where somebody looks at it."""
    return Progress(
        *Progress.get_default_columns()[:2],
        MofNCompleteColumn(),
        TextColumn("frames"),
        TimeRemainingColumn(),
        console=Console(stderr=True),
        disable=not sys.stderr.isatty(),
    )
