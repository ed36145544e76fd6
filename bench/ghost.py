"""How much of a red or orange thing stays behind where it was: the ghost of a ball.

Usage: scripts/bench ghost STREAM CAPTURE

Looks, in the held-out cameras, at pixels that were red in the frame before, have moved and are not
red now. Redness is R - (G + B) / 2; the excess of a pixel is its redness in the rendered picture
minus the median of the ring around all of these pixels, without what is red now. The capture itself
stands beside it, as what it shows there is seldom quite even.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro
from PIL import Image, ImageFilter
from rich.console import Console
from rich.progress import track
from rich.table import Table

from codec.arrays import Flags, Floats
from codec.console import run_command
from trainer.capture.capture import Mask
from trainer.score.scores import seen_of
from trainer.score.truth import captured, displayed, open_held_out

RED = 80 / 255
"""Redness from which on a pixel belongs to the thing: skin has less."""
EDGE_PX = 4
"""Width of the thing's edge, where its redness fades; its seams are within."""
RING_PX = 8
"""Width of the ring."""
MIN_LEFT_PX = 30
"""Pixels that the thing must have left in a picture: fewer are the noise of its edge."""
VISIBLE = 12 / 255
"""Excess from which on a pixel counts as part of a ghost."""


@dataclass(frozen=True)
class GhostConfig:
    """Looks for what a red thing leaves behind in the held-out cameras of a stream's capture."""

    stream: tyro.conf.Positional[Path]
    """Folder of the stream."""
    capture: tyro.conf.Positional[Path]
    """Folder of the capture that the stream was trained from."""


def redness(picture: Floats) -> Floats:
    """(H, W) from -1 to 1; picture: (H, W, 3) in 0..1."""
    red: Floats = picture[..., 0] - np.float32(0.5) * (picture[..., 1] + picture[..., 2])
    return red


def grown(pixels: Flags, by_px: int) -> Flags:
    """(H, W): the pixels at most that far, along rows and columns, from one of `pixels`."""
    image = Image.fromarray(pixels.astype(np.uint8) * 255)
    wider: Flags = np.asarray(image.filter(ImageFilter.MaxFilter(2 * by_px + 1))) > 0
    return wider


def left_and_around(
    before: Floats, now: Floats, moves: Flags, mask: Mask | None
) -> tuple[Flags, Flags]:
    """(H, W) each: the pixels that a red thing has left since the frame before, and the ring of
    others around them that it does not cover now. moves: the pixels that have moved."""
    free = ~grown(redness(now) >= RED / 2, EDGE_PX)
    left = moves & (redness(before) >= RED) & free
    ring = grown(left, RING_PX) & ~left & free
    return left, ring if mask is None else ring & (mask > 0)


def excess(picture: Floats, left: Flags, ring: Flags) -> Floats:
    """(n,) redness of the pixels `left` over the median of those of the ring."""
    red = redness(picture)
    over: Floats = red[left] - np.median(red[ring])
    return over


def excesses(config: GhostConfig) -> Iterator[tuple[str, Floats, Floats]]:
    """Camera, and (n,) the excess in the rendered picture and in the capture itself, of each frame
    in which a thing has left at least MIN_LEFT_PX. Raises the errors of `open_held_out`."""
    with open_held_out(config.stream, config.capture) as held_out:
        reader, manifest = held_out.reader, held_out.reader.manifest
        for frame in track(range(1, reader.num_frames), "ghosts", transient=True):
            seen = seen_of(held_out, frame)
            splats = reader.active_splats(frame, manifest.num_layers)
            for c, camera in enumerate(held_out.cameras):
                before = captured(held_out.shot(c, frame - 1).picture)
                truth, moves = seen.truths[c], seen.movements[c].pixels
                left, ring = left_and_around(before, truth, moves, seen.masks[c])
                if left.sum() >= MIN_LEFT_PX and ring.any():
                    shown = displayed(splats, camera, manifest.near_of(camera))
                    yield camera.name, excess(shown, left, ring), excess(truth, left, ring)


def table(found: dict[str, tuple[Floats, Floats]]) -> Table:
    """A row for each camera, and one for all; levels of 255."""
    measures = f"over {255 * VISIBLE:g}", "99 %", "largest"
    columns = [f"{of}\n{measure}" for of in ("rendered", "capture") for measure in measures]
    drawn = Table("camera", "pixels", *columns)
    every = tuple(np.concatenate(values) for values in zip(*found.values(), strict=True))
    for name, (shown, truth) in [*found.items(), ("all", every)]:
        cells = [f"{len(shown):,}"]
        for values in (shown, truth):
            high = 255 * np.quantile(values, 0.99), 255 * values.max()
            cells += [f"{(values > VISIBLE).sum():,}", *(f"{value:.1f}" for value in high)]
        drawn.add_row(name, *cells)
    return drawn


def run(config: GhostConfig) -> None:
    parts: dict[str, list[tuple[Floats, Floats]]] = {}
    for name, shown, truth in excesses(config):
        parts.setdefault(name, []).append((shown, truth))
    console = Console(width=110)
    if not parts:
        console.print("no red thing moves in the held-out cameras")
        return
    found = {
        name: (np.concatenate([p[0] for p in pairs]), np.concatenate([p[1] for p in pairs]))
        for name, pairs in parts.items()
    }
    console.print(table(found))


if __name__ == "__main__":
    run_command(GhostConfig, run, "bench ghost", __doc__ or "")
