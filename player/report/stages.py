"""How long each stage of a frame takes, from packets to a picture: the paper's Table 4 and Figure 8
for this player.

Every frame is drawn, one stage after another in one thread and as fast as it goes: what a window
does at the same time does not blur the figures.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from itertools import groupby, islice
from pathlib import Path
from typing import TypeVar

import numpy as np
from rich.table import Table

from codec.errors import InvalidError
from codec.slice import Slice
from codec.stream.manifest import Manifest
from player.config import PlayConfig
from player.playout.assembler import Assembler
from player.rehearsal import rehearse
from player.render.cpu import StepTimes
from player.render.gl import create_renderer
from player.render.renderer import Renderer
from player.source.directory import DirectorySource
from player.source.source import Packets
from player.view.path import CameraPath

STAGES = ("decode", "pack", "upload", "sort", "draw")
MAX_FRAMES = 10_000
"""Frames that are measured at most: a live stream need not end."""

Made = TypeVar("Made")


@dataclass(frozen=True, slots=True)
class StageTimes:
    """Times of one frame, milliseconds."""

    frame: int
    new_gs: int
    """Gaussians that came with it."""
    decode_ms: float
    pack_ms: float
    """Into the words that the GPU takes; on the CPU nothing."""
    upload_ms: float
    sort_ms: float
    draw_ms: float

    @property
    def stages_ms(self) -> tuple[float, ...]:
        """In the order of STAGES."""
        return (self.decode_ms, self.pack_ms, self.upload_ms, self.sort_ms, self.draw_ms)


@dataclass(frozen=True, slots=True)
class StageProfile:
    """All frames that were measured."""

    source: str
    renderer: str
    size: str
    fps: float
    frames: tuple[StageTimes, ...]

    def table(self) -> Table:
        """Milliseconds of each stage and of all: the median frame, and one of twenty is slower."""
        title = f"{self.source}: {len(self.frames)} frames, {self.size}, {self.renderer}"
        table = Table("ms", *STAGES, "overall", title=title)
        times = np.array([one.stages_ms for one in self.frames])
        times = np.column_stack([times, times.sum(axis=1)])
        for name, share in (("median", 50), ("95 %", 95)):
            table.add_row(name, *(f"{value:.2f}" for value in np.percentile(times, share, axis=0)))
        return table


def profile(config: PlayConfig) -> StageProfile:
    """Draws the stream's frames and measures each stage. Raises a SwingsError."""
    kind = rehearse(config.renderer, config.gl)
    opened = DirectorySource(
        Path(config.source), config.frames, config.layers, max_gaussians=config.max_gaussians
    )
    with closing(opened) as source:
        manifest, first = source.manifest, source.frames.first
        path = config.camera.of(manifest, config.size, source.frames)
        with closing(create_renderer(kind, manifest, config.gl)) as renderer:
            due = packets_of_frames(source.packets(), first)
            measured = measure(due, manifest, source.num_layers, first, renderer, path)
            frames = tuple(islice(measured, MAX_FRAMES))
            if not frames:
                raise InvalidError(f"{source.name} has no frame to measure")
            camera = path(first)
            size = f"{camera.width_px}x{camera.height_px}"
            return StageProfile(source.name, renderer.name, size, manifest.fps, frames)


def packets_of_frames(
    packets: Iterable[Packets], first_frame: int
) -> Iterator[tuple[int, list[Packets]]]:
    """Each frame that packets come into use with, and these packets."""
    for frame, due in groupby(packets, lambda one: max(first_frame, one.first_frame)):
        yield frame, list(due)


def measure(
    due: Iterable[tuple[int, list[Packets]]],
    manifest: Manifest,
    num_layers: int,
    first_frame: int,
    renderer: Renderer,
    path: CameraPath,
) -> Iterator[StageTimes]:
    """Takes each frame through all stages."""
    assembler = Assembler(manifest, num_layers, first_frame)
    steps = renderer.times = StepTimes()
    for frame, packets in due:
        slices, decode_ms = timed(partial(assembler.assemble, frame, packets))
        _, pack_ms = timed(partial(put_all, renderer, slices))
        renderer.render(frame, path(frame))
        new_gs = sum(len(slice.splats) for slice in slices)
        yield StageTimes(
            frame, new_gs, decode_ms, pack_ms, steps.upload_ms, steps.sort_ms, steps.draw_ms
        )


def put_all(renderer: Renderer, slices: Iterable[Slice]) -> None:
    for slice in slices:
        renderer.put(slice)


def timed(work: Callable[[], Made]) -> tuple[Made, float]:
    """The result of `work`, and its time in milliseconds."""
    began_s = time.perf_counter()
    made = work()
    return made, (time.perf_counter() - began_s) * 1000
