"""The moments of which a rig is made: spread evenly over the common time of all takes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import closing
from pathlib import Path

import numpy as np
from PIL import Image

from codec.arrays import Doubles

from .mapping import PICTURES_NAME, picture_name
from .offsets import Synchrony
from .takes import Take

JPEG_QUALITY = 95

UNCHANGED = 0.25
"""Mean difference of two small pictures, of 255, below which nothing has moved."""

SMALL_PX = 160


def write_moments(
    takes: Sequence[Take],
    synchrony: Synchrony,
    count: int,
    longest_px: int,
    folder: Path,
    advance: Callable[[float], None],
) -> tuple[list[tuple[int, int]], Doubles]:
    """Writes a picture of each camera and moment for mapping.py, at most `longest_px` wide and
    high. Gives the size of each camera's pictures, and (C, count - 1) by how much they change from
    moment to moment, in 255ths."""
    (folder / PICTURES_NAME).mkdir()
    times_s = (np.arange(count) + 0.5) / count * synchrony.duration_s
    sizes, changes = [], []
    for index, (take, start_s) in enumerate(zip(takes, synchrony.starts_s, strict=True)):
        scale = min(1.0, longest_px / max(take.width_px, take.height_px))
        sizes.append((round(take.width_px * scale), round(take.height_px * scale)))
        small = []
        with closing(take.open()) as source:
            for moment, time_s in enumerate(times_s):
                image = Image.fromarray(source.read(take.nearest_frame(start_s + time_s)))
                image = image.resize(sizes[-1], Image.Resampling.BOX)
                place = folder / PICTURES_NAME / picture_name(moment, index)
                image.save(place, quality=JPEG_QUALITY, subsampling=0)
                image.thumbnail((SMALL_PX, SMALL_PX))
                small.append(np.asarray(image.convert("L"), np.float64))
        changes.append(np.abs(np.diff(small, axis=0)).mean(axis=(1, 2)))
        advance((index + 1) / len(takes))
    return sizes, np.array(changes)
