"""The player's renderers: pictures per second, and time to put a due slice on the GPU.

Usage: scripts/bench play [--gaussians N ...] [--sizes WxH ...] [--rounds N]
       scripts/bench play --gaussians 10000 200000 --sizes 640x360    (a minute without a GPU)

First table: pictures per second with a moving camera. Each step ends before the next begins, and
nothing is read back. All renderers take turns, so that other load on the machine affects them
equally. sort: finds the visible Gaussians and their order; on the CPU also their places on the
picture.
Second table: `put` packs a slice on the update thread; `upload` is the following work of the thread
that draws, until the GPU has finished; bytes of a slice, and their ratio to the changed bytes.
Times are medians. The GPU is used if OpenGL has one; the renderer's name shows it.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from rich.console import Console
from rich.table import Table

from bench.play.roomful import SWIN_SIZE, changed_slice, first_window, manifest_of, slice_of
from codec.camera import Camera
from codec.console import option, run_command
from codec.errors import InvalidError
from codec.slice import Slice
from codec.stream.manifest import Manifest
from player.render.cpu import CpuRenderer, StepTimes
from player.render.gl import GlError, GlRenderer, Target
from player.render.renderer import GlVersion
from player.render.upload import texels_per_gaussian
from player.view.path import Size

SIZE = option("WxH", Size.parse)
UPLOAD_SIZE = Size(640, 360)
CHANGED_SHARE = 0.3
GAUSSIAN_BYTES = (4 * 14 + 1, 16 * texels_per_gaussian(0))
"""Bytes of one Gaussian in the CPU renderer, and in OpenGL."""

Drawing = CpuRenderer | GlRenderer


@dataclass(frozen=True, slots=True)
class PlayBenchConfig:
    """Sizes and rounds to measure."""

    gaussians: tuple[int, ...] = (10_000, 50_000, 200_000, 1_000_000)
    """Gaussians of a frame, multiples of 5."""
    sizes: tuple[Annotated[Size, SIZE], ...] = (Size(640, 360), Size(1352, 1014))
    """Sizes of the pictures."""
    rounds: int = 7
    """Number of pictures and slices in each median."""

    def __post_init__(self) -> None:
        """Raises InvalidError for counts that cannot be measured."""
        for count in self.gaussians:
            if count < SWIN_SIZE or count % SWIN_SIZE:
                raise InvalidError(f"gaussians {count} are not a multiple of {SWIN_SIZE}")
        if self.rounds < 1:
            raise InvalidError(f"rounds {self.rounds}: measure once at least")


@contextmanager
def open_renderers(manifest: Manifest) -> Iterator[dict[str, Drawing]]:
    """Every renderer that works here, by its name in the tables, with frame 0 uploaded."""
    renderers: dict[str, Drawing] = {"CPU": CpuRenderer(manifest)}
    for version in (GlVersion.V33, GlVersion.V43):
        try:
            # The target that a window uses.
            renderers[f"GL {version}"] = GlRenderer(manifest, Target.FLOAT16, version=version)
        except GlError as error:
            Console(stderr=True).print(f"no GL {version}: {error}")
    try:
        for renderer in renderers.values():
            for slice in first_window(manifest):
                renderer.put(slice)
            renderer.upload(0)
        yield renderers
    finally:
        for renderer in renderers.values():
            renderer.close()


def moved(camera: Camera, number: int) -> Camera:
    """The camera of picture `number`, 1 cm to the side of the previous picture's."""
    w2c = camera.w2c.copy()
    w2c[0, 3] += 0.01 * number
    return replace(camera, w2c=w2c)


def median_of(times_ms: list[float]) -> float:
    return float(np.median(times_ms[1:]))  # the first is not counted


def draw(config: PlayBenchConfig, table: Table) -> None:
    for num_gs in config.gaussians:
        for size in config.sizes:
            manifest = manifest_of(num_gs, size.width_px, size.height_px)
            with open_renderers(manifest) as renderers:
                draw_in_turns(config, manifest, renderers, table)


def draw_in_turns(
    config: PlayBenchConfig, manifest: Manifest, renderers: dict[str, Drawing], table: Table
) -> None:
    camera = manifest.camera()
    sort_ms: dict[str, list[float]] = {name: [] for name in renderers}
    draw_ms: dict[str, list[float]] = {name: [] for name in renderers}
    for number in range(config.rounds + 1):
        for name, renderer in renderers.items():
            times = renderer.times = StepTimes()
            renderer.render_again(0, moved(camera, number))
            sort_ms[name].append(times.sort_ms)
            draw_ms[name].append(times.draw_ms)
    for name in renderers:
        both_ms = [one + other for one, other in zip(sort_ms[name], draw_ms[name], strict=True)]
        table.add_row(
            f"{manifest.num_gs}",
            f"{camera.width_px}x{camera.height_px}",
            name,
            f"{1000 / median_of(both_ms):.1f}",
            f"{median_of(sort_ms[name]):.2f}",
            f"{median_of(draw_ms[name]):.2f}",
        )


def slices_to_come(kind: str, count: int, manifest: Manifest) -> Iterator[Slice]:
    for birth in range(1, count + 1):
        if kind == "all":
            yield slice_of(birth, manifest.slice_size, manifest.num_gs)
        else:
            yield changed_slice(birth, CHANGED_SHARE, kind == "scattered", manifest)


def upload(config: PlayBenchConfig, table: Table) -> None:
    size = UPLOAD_SIZE
    for num_gs in config.gaussians:
        manifest = manifest_of(num_gs, size.width_px, size.height_px)
        for kind in ("all", "scattered", "runs"):
            with open_renderers(manifest) as renderers:
                for name, renderer in renderers.items():
                    upload_one_after_another(config, manifest, kind, name, renderer, table)


def upload_one_after_another(
    config: PlayBenchConfig,
    manifest: Manifest,
    kind: str,
    name: str,
    renderer: Drawing,
    table: Table,
) -> None:
    put_ms, upload_ms, changed_bytes = [], [], 0
    before_bytes = renderer.uploaded_bytes
    for slice in slices_to_come(kind, config.rounds + 1, manifest):
        began_s = time.perf_counter()
        renderer.put(slice)
        put_ms.append((time.perf_counter() - began_s) * 1000)
        times = renderer.times = StepTimes()
        renderer.upload(slice.birth)
        upload_ms.append(times.upload_ms)
        changed_bytes += len(slice.splats) * GAUSSIAN_BYTES[isinstance(renderer, GlRenderer)]
    uploaded_bytes = renderer.uploaded_bytes - before_bytes
    due_ms = [one + other for one, other in zip(put_ms, upload_ms, strict=True)]
    table.add_row(
        f"{manifest.slice_size}",
        kind if kind == "all" else f"{CHANGED_SHARE:.0%} {kind}",
        name,
        f"{median_of(put_ms):.2f}",
        f"{median_of(upload_ms):.2f}",
        f"{median_of(due_ms):.2f}",
        f"{uploaded_bytes // len(put_ms)}",
        f"{uploaded_bytes / changed_bytes:.2f}",
    )


def run(config: PlayBenchConfig) -> None:
    console = Console(width=100)
    with open_renderers(manifest_of(SWIN_SIZE, 8, 8)) as renderers:
        for renderer in renderers.values():
            console.print(renderer.name)
    drawn = Table("Gaussians", "picture", "with", "pictures/s", "sort ms", "draw ms")
    draw(config, drawn)
    console.print(drawn)
    uploaded = Table("slice", "changed", "with", "put ms", "upload ms", "both ms", "bytes", "x")
    upload(config, uploaded)
    console.print(uploaded)


def main() -> None:
    run_command(PlayBenchConfig, run, "scripts/bench play", "Measures the player's renderers.")


if __name__ == "__main__":
    main()
