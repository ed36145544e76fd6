"""Times of the player's renderers: drawing, and bringing one slice to where it is drawn from.

The second table is of slices that change only some rows of their lane.

Usage: scripts/bench render [--quick]

put: packing on the update thread. upload: what the render thread then hands to OpenGL. order: the
visible Gaussians, farthest first. ring: a slice into the memory of the CPU renderer. Medians;
OpenGL's name says whether it has a GPU.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import numpy.typing as npt
from rich.console import Console
from rich.table import Table

from codec.camera import Camera
from codec.console import run_command
from codec.profiles.profile import Profile
from codec.slice import Slice
from codec.splats import Splats
from codec.stream.manifest import Manifest
from player.render.cpu import CpuRenderer
from player.render.gl import GlError, GlRenderer
from player.render.order import Order
from player.render.ring import Ring

SWIN_SIZE = 5
ROUNDS = 7

LANE_ROWS, CHANGED_ROWS = 30_000, 9_000
RUN_ROWS = 1000

SIZES = ((10_000, 320, 180), (50_000, 640, 360), (200_000, 640, 360), (200_000, 1280, 720))


@dataclass(frozen=True, slots=True)
class RenderConfig:
    """What to measure."""

    quick: bool = False
    """Measure the smallest size only."""


@dataclass(frozen=True, slots=True)
class Row:
    """One line of the table; None where OpenGL cannot start. Milliseconds."""

    num_gs: int
    width_px: int
    height_px: int
    cpu_ms: float
    gl_ms: float | None
    put_ms: float | None
    upload_ms: float | None
    upload_bytes: int | None
    order_ms: float


def manifest_of(num_gs: int, width_px: int, height_px: int) -> Manifest:
    focal_px = 0.9 * width_px
    size = (width_px, height_px, focal_px, focal_px, width_px / 2, height_px / 2)
    return Manifest(
        fps=30.0,
        swin_size=SWIN_SIZE,
        num_gs=num_gs,
        layers=(1.0,),
        segment_frames=30,
        sh_degree=0,
        profile=Profile.RAW,
        antialias=False,
        near_m=0.2,
        bounds=((-3.0, -2.0, 0.0), (3.0, 2.0, 6.0)),
        cameras=(Camera("front", *size, np.eye(4)),),
        default_camera="front",
        live=False,
    )


def slice_of(birth: int, count: int, total: int) -> Slice:
    """A room's worth of Gaussians: the more there are, the smaller each is."""
    rng = np.random.default_rng(birth + 100)
    arrays = (
        rng.uniform(-1, 1, (count, 3)) * (3, 2, 3) + (0, 0, 3),
        rng.normal(np.log(1.2 / total ** (1 / 2.2)), 0.7, (count, 3)),
        rng.normal(size=(count, 4)),
        rng.normal(0, 2, count),
        rng.normal(0, 0.6, (count, 1, 3)),
    )
    splats = Splats(*(array.astype(np.float32) for array in arrays))
    return Slice(birth, splats, np.zeros(count, np.uint8))


def median_ms(work: Callable[[int], object]) -> float:
    """The median time of `work`, called with 0, 1, ..., after one call that is not counted."""
    times = []
    for number in range(ROUNDS + 1):
        began_s = time.perf_counter()
        work(number)
        times.append(time.perf_counter() - began_s)
    return float(np.median(times[1:])) * 1000


def seconds_of(work: Callable[[], object]) -> float:
    began_s = time.perf_counter()
    work()
    return time.perf_counter() - began_s


def order_ms(slices: list[Slice], manifest: Manifest) -> float:
    order = Order(SWIN_SIZE, manifest.slice_size)
    for slice in slices[:SWIN_SIZE]:
        starts = np.zeros(len(slice.splats), np.int32)
        order.put(slice.lane(SWIN_SIZE), 1, slice.splats.means, starts)
    return median_ms(lambda _: order.far_first(0, manifest.camera().w2c, manifest.near_m))


def measure(num_gs: int, width_px: int, height_px: int) -> Row:
    manifest = manifest_of(num_gs, width_px, height_px)
    camera = manifest.camera()
    births = range(1 - SWIN_SIZE, 2 * ROUNDS + 8)
    slices = [slice_of(birth, manifest.slice_size, num_gs) for birth in births]
    cpu = CpuRenderer(manifest)
    for slice in slices[:SWIN_SIZE]:
        cpu.put(slice)
    cpu_ms = median_ms(lambda _: cpu.render(0, camera))
    numbers = (num_gs, width_px, height_px, cpu_ms)
    try:
        gl = GlRenderer(manifest)
    except GlError as error:
        Console(stderr=True).print(f"no OpenGL: {error}")
        return Row(*numbers, None, None, None, None, order_ms(slices, manifest))
    for slice in slices[:SWIN_SIZE]:
        gl.put(slice)
    gl_ms = median_ms(lambda _: gl.render(0, camera))
    later = iter(slices[SWIN_SIZE:])
    put_ms = median_ms(lambda _: gl.put(next(later)))
    before_bytes = gl.uploaded_bytes
    upload_ms = median_ms(lambda number: gl.upload(1 + number))
    upload_bytes = (gl.uploaded_bytes - before_bytes) // (ROUNDS + 1)
    gl.close()
    return Row(*numbers, gl_ms, put_ms, upload_ms, upload_bytes, order_ms(slices, manifest))


@dataclass(frozen=True, slots=True)
class ChangeRow:
    """One line of the second table; None where OpenGL cannot start. Milliseconds."""

    where: str
    ring_ms: float
    put_ms: float | None
    upload_ms: float | None
    upload_bytes: int | None


def scattered(rng: np.random.Generator) -> npt.NDArray[np.int32]:
    return np.sort(rng.choice(LANE_ROWS, CHANGED_ROWS, replace=False)).astype(np.int32)


def clustered(rng: np.random.Generator) -> npt.NDArray[np.int32]:
    runs = np.sort(rng.choice(LANE_ROWS // RUN_ROWS, CHANGED_ROWS // RUN_ROWS, replace=False))
    rows: npt.NDArray[np.int32] = (runs[:, None] * RUN_ROWS + np.arange(RUN_ROWS)).ravel()
    return rows.astype(np.int32)


def measure_changes(
    where: str, rows_of: Callable[[np.random.Generator], npt.NDArray[np.int32]]
) -> ChangeRow:
    num_gs = SWIN_SIZE * LANE_ROWS
    manifest = manifest_of(num_gs, 640, 360)
    rng = np.random.default_rng(1)
    ring = Ring(SWIN_SIZE, LANE_ROWS, 0)
    whole = [slice_of(birth, LANE_ROWS, num_gs) for birth in range(1 - SWIN_SIZE, 1)]
    changes = [
        replace(slice_of(birth, CHANGED_ROWS, num_gs), rows=rows_of(rng))
        for birth in range(1, 4 * ROUNDS)
    ]
    for slice in whole:
        ring.put(slice)
    ring_ms = float(np.median([seconds_of(partial(ring.put, one)) for one in changes])) * 1000
    try:
        gl = GlRenderer(manifest)
    except GlError:
        return ChangeRow(where, ring_ms, None, None, None)
    for slice in whole:
        gl.put(slice)
    gl.upload(0)
    before_bytes, put_s, upload_s = gl.uploaded_bytes, [], []
    for one in changes:
        put_s.append(seconds_of(partial(gl.put, one)))
        upload_s.append(seconds_of(partial(gl.upload, one.birth)))
    upload_bytes = (gl.uploaded_bytes - before_bytes) // len(changes)
    gl.close()
    put_ms, upload_ms = float(np.median(put_s)) * 1000, float(np.median(upload_s)) * 1000
    return ChangeRow(where, ring_ms, put_ms, upload_ms, upload_bytes)


def print_changes() -> None:
    table = Table("changed", "ring ms", "put ms", "upload ms", "upload bytes")
    for where, rows_of in (("scattered", scattered), ("in runs", clustered)):
        row = measure_changes(where, rows_of)
        timed = (row.ring_ms, row.put_ms, row.upload_ms)
        table.add_row(
            f"{CHANGED_ROWS} of {LANE_ROWS}, {row.where}",
            *("-" if value is None else f"{value:.2f}" for value in timed),
            f"{row.upload_bytes or '-'}",
        )
    Console(width=110).print(table)


def run(config: RenderConfig) -> None:
    rows = [measure(*size) for size in (SIZES[:1] if config.quick else SIZES)]
    table = Table("Gaussians", "slice", "picture", "CPU ms", "GL ms", "put ms", "upload ms")
    table.add_column("upload bytes")
    table.add_column("order ms")
    for row in rows:
        timed = (row.cpu_ms, row.gl_ms, row.put_ms, row.upload_ms)
        table.add_row(
            f"{row.num_gs}",
            f"{row.num_gs // SWIN_SIZE}",
            f"{row.width_px}x{row.height_px}",
            *("-" if value is None else f"{value:.2f}" for value in timed),
            f"{row.upload_bytes or '-'}",
            f"{row.order_ms:.2f}",
        )
    Console(width=110).print(table)
    print_changes()


def main() -> None:
    run_command(RenderConfig, run, "scripts/bench render", "Measures how long the renderers take.")


if __name__ == "__main__":
    main()
