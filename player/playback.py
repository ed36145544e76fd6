"""One playback from its options to its end: opens everything, runs the threads, sums up."""

from __future__ import annotations

import json
import logging
import os
import sys
from collections.abc import Callable
from contextlib import ExitStack, closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any
from urllib.parse import urlsplit

import numpy as np
import numpy.typing as npt
import tyro
from rich.console import Console
from rich.progress import MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from codec.errors import InvalidError
from codec.framerange import FrameRange
from player.link.link import Link
from player.link.relay import Relay
from player.playout.clock import Clock
from player.playout.queues import Events
from player.playout.threads import Threads, render_thread
from player.playout.timeline import FrameRecord, Playout, PlayoutConfig, PlayoutTotals
from player.render.renderer import Renderer, RendererKind, create_renderer
from player.show.sink import check_capture, open_sink, to_bytes
from player.source.locate import is_url, open_source
from player.source.source import Source
from player.view.path import CameraPath, Size, camera_path, check_path

log = logging.getLogger(__name__)

Floats = npt.NDArray[np.float32]

CAPTURE_QUEUE = PlayoutConfig(max_frames=1 << 30)
"""Bounded in bytes only: a drawer that lags should look to a server like a slow link only when it
must."""


@dataclass(frozen=True, slots=True)
class PlayConfig:
    """What to play, and how to show it."""

    source: tyro.conf.Positional[Annotated[str, tyro.conf.arg(metavar="SOURCE")]]
    """Folder of a stream, URL of a served stream (http://HOST:PORT, .../watch/NAME), or any URL
    under which a stream's files lie."""
    capture: Annotated[Path | None, tyro.conf.arg(metavar="OUT")] = None
    """Write every frame, exactly once, to this .mp4 or folder of PNGs. Without it: a window."""
    layers: Annotated[str, tyro.conf.arg(metavar="auto|N")] = "auto"
    """Layers of each slice, 1 to all; auto lets a server choose, and takes all elsewhere."""
    camera: Annotated[str, tyro.conf.arg(metavar="PATH")] = "default"
    """default, camera:NAME, orbit, orbit:DEGREES, or a .json file of key frames."""
    size: Annotated[str | None, tyro.conf.arg(metavar="WxH")] = None
    """Size of the picture, as 1280x720; without it that of the camera."""
    frames: Annotated[str | None, tyro.conf.arg(metavar="A:B")] = None
    """Frames to show, as 30:60 (without 60), 30: or :60."""
    renderer: RendererKind = RendererKind.AUTO
    """auto takes OpenGL where it works, and says so where it does not."""
    link: Annotated[str | None, tyro.conf.arg(metavar="RATE|TRACE")] = None
    """Play over a slower link: a rate (8M), a rate and a latency (8M,20ms), or a .json trace."""
    report: Annotated[Path | None, tyro.conf.arg(metavar="JSON")] = None
    """Write what became of each frame, and the totals, to this JSON file."""

    def __post_init__(self) -> None:
        """Raises InvalidError for options that are wrong whatever the stream is."""
        self.parsed_layers()
        self.parsed_frames()
        self.parsed_size()
        check_path(self.camera)
        self.parsed_link()
        if self.capture is not None:
            check_capture(self.capture)
        elif self.renderer is RendererKind.CPU:
            raise InvalidError("a window is drawn by OpenGL; --renderer cpu goes with --capture")
        if self.report is not None and not self.report.parent.is_dir():
            raise InvalidError(f"report {self.report}: there is no folder {self.report.parent}")

    def parsed_layers(self) -> int | None:
        """None for auto."""
        if self.layers == "auto":
            return None
        if not (self.layers.isdecimal() and int(self.layers) >= 1):
            raise InvalidError(f"layers {self.layers!r} are neither auto nor a number from 1 on")
        return int(self.layers)

    def parsed_frames(self) -> FrameRange:
        return FrameRange.parse(self.frames) if self.frames is not None else FrameRange()

    def parsed_size(self) -> Size | None:
        return Size.parse(self.size) if self.size is not None else None

    def parsed_link(self) -> Link | None:
        if self.link is None:
            return None
        if not is_url(self.source) or not self.source.lower().startswith("http://"):
            raise InvalidError(f"--link slows down http:// URLs; {self.source} is none")
        return Link.parse(self.link)


@dataclass(slots=True)
class PlaySummary:
    """How a playback went."""

    source: str
    renderer: str
    totals: PlayoutTotals
    received_bytes: int
    uploaded_bytes: int
    link_bytes: int | None
    """Bytes that came over `--link`; None without it."""
    records: list[FrameRecord] = field(default_factory=list)
    """One for each frame, kept for `--report` only: it grows with the stream."""

    def lines(self) -> list[str]:
        """The summary for people."""
        totals = self.totals
        return [
            f"{totals.frames} frames of {self.source}, drawn by {self.renderer}",
            f"startup {totals.startup_s:.3f} s, {totals.stalls} stalls, "
            f"{totals.stalled_s:.3f} s stalled",
            f"{totals.mean_layers:.2f} layers on average, {totals.wire_bytes} bytes of slices",
        ]

    def to_json(self) -> dict[str, Any]:
        totals = self.totals
        return {
            "source": self.source,
            "renderer": self.renderer,
            "totals": {
                "frames": totals.frames,
                "startup_s": totals.startup_s,
                "stalls": totals.stalls,
                "stalled_s": totals.stalled_s,
                "mean_layers": totals.mean_layers,
                "bytes": totals.wire_bytes,
                "received_bytes": self.received_bytes,
                "uploaded_bytes": self.uploaded_bytes,
                "link_bytes": self.link_bytes,
                "most_frames_waiting": totals.most_frames_waiting,
                "most_bytes_waiting": totals.most_bytes_waiting,
            },
            "frames": [
                {
                    "frame": record.frame,
                    "layers": record.layers,
                    "due_s": record.due_s,
                    "shown_s": record.shown_s,
                    "bytes": record.wire_bytes,
                }
                for record in self.records
            ],
        }


def play(config: PlayConfig) -> PlaySummary:
    """Plays the stream to its end, or until the window is closed."""
    clock = Clock(real=config.capture is None)
    with ExitStack() as stack:
        if config.capture is None:
            # Finds and loads the system's library for windows, which a capture does without.
            from player.show.window import show_window, window_system

            stack.enter_context(window_system())
        relay = _start_relay(config)
        if relay is not None:
            stack.enter_context(relay)
        source = open_source(
            config.source,
            config.parsed_frames(),
            config.parsed_layers(),
            relay.address if relay is not None else None,
        )
        stack.callback(source.close)
        playout = Playout(
            source.frames.first,
            source.manifest.swin_size,
            source.manifest.fps,
            CAPTURE_QUEUE if config.capture is not None else PlayoutConfig(),
        )
        events = Events(playout, clock)
        records: list[FrameRecord] = []
        keep: Callable[[FrameRecord], None] = records.append if config.report else lambda _: None
        renderer: Renderer
        if config.capture is not None:
            renderer = _capture(config, config.capture, source, events, keep)
        else:
            renderer = show_window(_path(config, source), source, events, keep)
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


def _start_relay(config: PlayConfig) -> Relay | None:
    link = config.parsed_link()
    if link is None:
        return None
    parts = urlsplit(config.source)
    if not parts.hostname:
        raise InvalidError(f"{config.source} is no URL: it names no host")
    try:
        return Relay(link, parts.hostname, parts.port or 80)
    except ValueError as error:  # urlsplit leaves the port unchecked until it is asked for
        raise InvalidError(f"{config.source} is no URL: {error}") from error


def _path(config: PlayConfig, source: Source) -> CameraPath:
    return camera_path(config.camera, source.manifest, config.parsed_size(), source.frames)


def _capture(
    config: PlayConfig,
    output: Path,
    source: Source,
    events: Events,
    keep: Callable[[FrameRecord], None],
) -> Renderer:
    """Draws every frame into files; gives the renderer, closed, for its name and counters."""
    path = _path(config, source)
    first = path(source.frames.first)
    size = Size(first.width_px, first.height_px)
    with (
        Threads(source, events) as threads,
        closing(create_renderer(config.renderer, source.manifest)) as renderer,
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


def write_report(path: Path, summary: PlaySummary) -> None:
    """Writes the report as JSON; the file is whole or absent."""
    temporary = path.with_name(f".{path.name}.partial")
    temporary.write_text(json.dumps(summary.to_json(), indent=1) + "\n", encoding="utf-8")
    os.replace(temporary, path)
