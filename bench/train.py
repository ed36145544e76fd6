"""Where a training step's time goes on the CPU, stage by stage, over Gaussians and resolutions."""

from __future__ import annotations

import os
import time
from collections.abc import Callable

os.environ.setdefault("OMP_WAIT_POLICY", "passive")

import numpy as np
from rich.console import Console
from rich.table import Table

from codec.camera import Camera
from player.render.project import Projection, project_kernel
from player.render.tiles import blend_tiles, list_tiles
from trainer.loss import Workspace, photometric_loss
from trainer.optimiser import Adam, OptimiserConfig, add_noise
from trainer.raster.blend_backward import PAIR_GRADIENT, blend_tiles_backward
from trainer.raster.cpu import Parameters, Scratch, View, backward, render

REPEATS = 15
CASES = [(5_000, 320, 180), (20_000, 320, 180), (20_000, 640, 360), (60_000, 640, 360)]


def median_ms(work: Callable[[], object]) -> float:
    work()
    times = []
    for _ in range(REPEATS):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return 1e3 * float(np.median(times))


def scene(count: int) -> Parameters:
    """Sizes and opacities as a trained scene has them: many small ones, few large ones."""
    rng = np.random.default_rng(0)
    values = Parameters.zeros(count, 0)
    values.means[:] = rng.uniform(-2, 2, (count, 3))
    values.log_scales[:] = rng.normal(np.log(0.03 * (20_000 / count) ** (1 / 3)), 0.6, (count, 3))
    values.quats[:] = rng.normal(size=(count, 4))
    values.logit_opacities[:] = rng.normal(-1, 1.5, count)
    values.sh[:, 0] = rng.normal(size=(count, 3))
    return values


def stages(count: int, width_px: int, height_px: int) -> dict[str, float]:
    """Milliseconds of each stage, and of the whole step."""
    w2c = np.eye(4)
    w2c[2, 3] = 3.0
    camera = Camera(
        "bench", width_px, height_px, width_px / 2, width_px / 2, width_px / 2, height_px / 2, w2c
    )
    view, values = View.prepare(camera, 0.2), scene(count)
    rows = np.arange(count, dtype=np.int32)
    target = np.random.default_rng(1).random((3, height_px, width_px)).astype(np.float32)
    work = Workspace(target.shape)
    gain, bias = np.ones(3, np.float32), np.zeros(3, np.float32)
    gradients, adam = Parameters.zeros(count, 0), Adam(count, 0, OptimiserConfig())
    ages = np.zeros(count, np.float32)
    rendered = render(values, rows, view)
    loss = photometric_loss(rendered.picture, target, 0.2, gain, bias, work)
    p, lists = rendered.projection, rendered.lists
    pair_grads = np.empty((len(lists.pairs), PAIR_GRADIENT), np.float32)
    spare, scratch = Projection.allocate(count), Scratch()

    def step() -> None:
        done = render(values, rows, view, scratch)
        found = photometric_loss(done.picture, target, 0.2, gain, bias, work)
        backward(done, values, found.picture_grad, count, gradients)
        adam.step(values, gradients, rows, 0.0, ages)
        noise()

    def noise() -> None:
        add_noise(*values.arrays()[:4], rows, np.float32(0), np.float32(0.005), np.float32(100), 1)

    result = {
        "project": median_ms(
            lambda: project_kernel(
                *values.arrays(),
                rows,
                view.vector,
                view.tiles_x,
                view.tiles_y,
                spare.projected,
                spare.depths,
                spare.tile_boxes,
            )
        ),
        "tile lists": median_ms(lambda: list_tiles(p, view.tiles_x, view.tiles_y)),
        "blend": median_ms(
            lambda: blend_tiles(
                p.projected,
                lists.starts,
                lists.gaussians,
                lists.order,
                view.tiles_x,
                rendered.picture,
            )
        ),
        "loss": median_ms(
            lambda: photometric_loss(rendered.picture, target, 0.2, gain, bias, work)
        ),
        "blend backward": median_ms(
            lambda: blend_tiles_backward(
                p.projected,
                lists.starts,
                lists.gaussians,
                lists.pairs,
                lists.order,
                view.tiles_x,
                rendered.picture,
                loss.picture_grad,
                pair_grads,
            )
        ),
        "whole backward": median_ms(
            lambda: backward(rendered, values, loss.picture_grad, count, gradients)
        ),
        "Adam": median_ms(lambda: adam.step(values, gradients, rows, 0.0, ages)),
        "noise": median_ms(noise),
        "whole step": median_ms(step),
    }
    result["pairs"] = float(len(lists.pairs))
    return result


def main() -> None:
    table = Table(title="training step, ms (medians)")
    columns = None
    for count, width_px, height_px in CASES:
        found = stages(count, width_px, height_px)
        if columns is None:
            columns = list(found)
            for name in ("Gaussians", "size", *columns, "outside blending"):
                table.add_column(name, justify="right")
        blending = found["blend"] + found["blend backward"]
        table.add_row(
            str(count),
            f"{width_px}x{height_px}",
            *(
                f"{found[name]:.1f}" if name != "pairs" else f"{found[name]:.0f}"
                for name in columns
            ),
            f"{100 * (1 - blending / found['whole step']):.0f} %",
        )
    Console(width=160).print(table)


if __name__ == "__main__":
    main()
