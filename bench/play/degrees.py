"""Harmonics of degree 0 to 3: drawing time, and the error of keeping colours while the camera moves
slightly.

Usage: scripts/bench degrees [--gaussians N] [--size WxH] [--rounds N]

First table: milliseconds per picture at each degree, with a still camera and with a camera that
moves 5 cm per picture, so that all colours are evaluated again. Degrees and cameras take turns, so
that other load on the machine affects them equally. Times are medians, of wall time and of the
process's CPU time, each with its ratio to degree 0.
Second table, CPU renderer at degree 3: a camera that drifts sideways, 30 pictures per second. turn:
angle of the median Gaussian from one picture to the next; evaluated: share of the shown Gaussians
whose colour was evaluated for a picture; PSNR: against a picture with all colours new, over the
drawn pixels.
"""

from __future__ import annotations

import time
from contextlib import ExitStack
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from rich.console import Console
from rich.table import Table

from bench.play.play import SIZE, UPLOAD_SIZE, Drawing, open_renderers
from bench.play.roomful import SWIN_SIZE, first_window, manifest_of
from codec.arrays import Doubles
from codec.camera import Camera
from codec.console import run_command
from codec.errors import InvalidError
from codec.splats import MAX_SH_DEGREE
from player.render.cpu import CpuRenderer
from player.render.project import COLOUR_TURN_RAD
from player.view.path import Size

STEP_M = 0.05
"""Movement of the camera from picture to picture, so large that no colour is kept."""

SPEEDS_M_S = (0.01, 0.03, 0.1, 0.3, 1.0)
DRIFT_PICTURES = 12
FPS = 30


@dataclass(frozen=True, slots=True)
class DegreesBenchConfig:
    """Scene, picture size and number of rounds."""

    gaussians: int = 200_000
    """Gaussians of a frame, a multiple of 5."""
    size: Annotated[Size, SIZE] = UPLOAD_SIZE
    """Size of the pictures."""
    rounds: int = 15
    """Number of pictures in each median."""

    def __post_init__(self) -> None:
        """Raises InvalidError for counts that cannot be measured."""
        if self.gaussians < SWIN_SIZE or self.gaussians % SWIN_SIZE:
            raise InvalidError(f"gaussians {self.gaussians} is not a multiple of {SWIN_SIZE}")
        if self.rounds < 1:
            raise InvalidError(f"rounds {self.rounds}: measure once at least")


def moved(camera: Camera, by_m: float) -> Camera:
    """The camera, moved sideways by `by_m`."""
    w2c = camera.w2c.copy()
    w2c[0, 3] -= by_m
    return replace(camera, w2c=w2c)


def time_of(renderer: Drawing, camera: Camera) -> tuple[float, float]:
    """Milliseconds of a picture: wall time, and CPU time of the process."""
    clock_s, cpu_s = time.perf_counter(), time.process_time()
    renderer.render_again(0, camera)
    return 1e3 * (time.perf_counter() - clock_s), 1e3 * (time.process_time() - cpu_s)


def medians_of(times: list[tuple[float, float]]) -> Doubles:
    """Medians of wall time and of CPU time; the first picture is not counted."""
    medians: Doubles = np.median(times[1:], axis=0)
    return medians


def costs(config: DegreesBenchConfig, table: Table) -> None:
    times: dict[tuple[str, int, str], list[tuple[float, float]]] = {}
    with ExitStack() as opened:
        by_degree = []
        for sh_degree in range(MAX_SH_DEGREE + 1):
            size = config.size.width_px, config.size.height_px
            manifest = manifest_of(config.gaussians, *size, sh_degree)
            by_degree.append(opened.enter_context(open_renderers(manifest)))
        camera = manifest.camera()
        for number in range(config.rounds + 1):
            for name in by_degree[0]:
                for sh_degree, renderers in enumerate(by_degree):
                    renderer = renderers[name]
                    moving = moved(camera, STEP_M * (number + 1))
                    taken = time_of(renderer, moving)
                    times.setdefault((name, sh_degree, "moving"), []).append(taken)
                    taken = time_of(renderer, moving)
                    times.setdefault((name, sh_degree, "still"), []).append(taken)
    for (name, sh_degree, kind), found in times.items():
        clock_ms, cpu_ms = medians_of(found)
        ratio, cpu_ratio = medians_of(found) / medians_of(times[name, 0, kind])
        table.add_row(
            name, f"{sh_degree}", kind, f"{clock_ms:.1f}", f"{ratio:.3f}", f"{cpu_ms:.1f}",
            f"{cpu_ratio:.3f}",
        )  # fmt: skip


def drifts(config: DegreesBenchConfig, table: Table) -> None:
    manifest = manifest_of(config.gaussians, config.size.width_px, config.size.height_px, 3)
    for speed_m_s in SPEEDS_M_S:
        keeping = CpuRenderer(manifest)
        slices = first_window(manifest)
        for slice in slices:
            keeping.put(slice)
        keeping.render(0, manifest.camera())
        seen = keeping.seen
        shown = seen.seen_from[:, 0] < 1e3
        evaluated, psnrs_db = [], []
        for number in range(1, DRIFT_PICTURES + 1):
            camera = moved(manifest.camera(), number * speed_m_s / FPS)
            picture = keeping.render_again(0, camera)
            new = (seen.seen_from == camera.position.astype(np.float32)).all(axis=1)
            evaluated.append(np.count_nonzero(new) / np.count_nonzero(shown))
            fresh = CpuRenderer(manifest)
            for slice in slices:
                fresh.put(slice)
            wanted = fresh.render(0, camera)
            error = (picture - wanted)[(wanted > 0).any(axis=2)].astype(np.float64)
            psnrs_db.append(-10 * np.log10(max(float(np.mean(error**2)), 1e-12)))
        means = np.concatenate([slice.splats.means for slice in slices])
        distance_m = np.median(np.linalg.norm(means, axis=1))
        table.add_row(
            f"{speed_m_s:g}", f"{speed_m_s / FPS / distance_m:.5f}",
            f"{100 * np.mean(evaluated):.0f} %", f"{np.mean(psnrs_db):.1f}", f"{min(psnrs_db):.1f}",
        )  # fmt: skip


def run(config: DegreesBenchConfig) -> None:
    console = Console()
    title = f"{config.gaussians} Gaussians, {config.size.width_px}x{config.size.height_px}"
    table = Table(title=title)
    for name in ("", "degree", "camera", "ms", "to degree 0", "CPU ms", "to degree 0"):
        table.add_column(name, justify="right")
    costs(config, table)
    console.print(table)
    table = Table(title=f"Degree 3, colours kept up to a turn of {COLOUR_TURN_RAD} rad")
    for name in ("m/s", "turn, rad", "evaluated", "PSNR, dB", "least"):
        table.add_column(name, justify="right")
    drifts(config, table)
    console.print(table)


def main() -> None:
    run_command(DegreesBenchConfig, run, "scripts/bench degrees", "Measures harmonics.")


if __name__ == "__main__":
    main()
