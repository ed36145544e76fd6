"""The frames of a sequence: files, one for each frame, in order of number, or what a container
holds."""

from __future__ import annotations

import re
from itertools import pairwise
from pathlib import Path

from codec.errors import InvalidError
from codec.interop.containers import ContainedFrame, contained_frames
from codec.interop.formats import READ, has_known_suffix, is_model_folder

FramePlace = Path | ContainedFrame
"""Where the Gaussians of a frame are."""


def find_frames(source: Path) -> list[FramePlace]:
    """Where the frames of `source` are: in a container, one file or folder of a still model, or the
    files of a folder (`find_files`). Raises InvalidError, or a CodecError for a bad container."""
    contained = contained_frames(source)
    return [*find_files(source)] if contained is None else [*contained]


FPS_NAME = "fps.txt"
"""A file in a folder of a sequence or of pictures with the frames per second, a number."""

MAX_NAMED = 5
"""Gaps that a message names."""


def number_of(path: Path) -> int | None:
    """The last number in the name of `path`, without its suffix; None if it has none."""
    digits = re.findall(r"[0-9]+", path.stem)
    return int(digits[-1]) if digits else None


def find_files(source: Path) -> list[Path]:
    """The model `source`, or those in the folder `source`, files or folders, by the last number in
    their names.

    Numbers may begin anywhere and go on by any step that stays the same. Raises InvalidError for a
    folder without files of Gaussians, a name without a number, two names with the same number, a
    number that is missing, or a name of something else than a file.
    """
    if not source.is_dir() or is_model_folder(source):
        return [source]
    numbered: dict[int, Path] = {}
    for path in sorted(source.iterdir()):
        is_folder = is_model_folder(path)
        if path.name.startswith(".") or not (is_folder or has_known_suffix(path)):
            continue
        number = number_of(path)
        if number is None:
            raise InvalidError(f"{path}: its name has no number to sort a sequence by")
        if not (is_folder or path.is_file()):
            what = "a broken link" if path.is_symlink() else "not a regular file"
            raise InvalidError(f"{path} is {what}; replace or remove it")
        first = numbered.setdefault(number, path)
        if first is not path:
            raise InvalidError(f"{source}: {first.name} and {path.name} have the same number")
    if not numbered:
        raise InvalidError(
            f"{source}: no file of Gaussians in this folder ({READ}), and no folder with "
            "point_cloud/iteration_N/point_cloud.ply for each frame"
        )
    numbers = sorted(numbered)
    step = min((b - a for a, b in pairwise(numbers)), default=1)
    gaps = [(a, b) for a, b in pairwise(numbers) if b - a != step]
    if gaps:
        a, b = gaps[0]
        raise InvalidError(
            f"{source}: {_missing(gaps, step)} between {numbered[a].name} and {numbered[b].name}"
        )
    return [numbered[number] for number in numbers]


def _missing(gaps: list[tuple[int, int]], step: int) -> str:
    """Names the numbers that are missing in `gaps`, each given by the two numbers around it."""
    ranges = [f"{a + step}" if b - a <= 2 * step else f"{a + step} to {b - step}" for a, b in gaps]
    if len(gaps) == 1 and gaps[0][1] - gaps[0][0] <= 2 * step:
        return f"number {ranges[0]} is missing"
    if len(gaps) == 1:
        return f"numbers {ranges[0]} are missing"
    more = f" and in {len(gaps) - MAX_NAMED} more gaps" if len(gaps) > MAX_NAMED else ""
    named = ", ".join(ranges[:MAX_NAMED])
    return f"{len(gaps)} gaps; numbers {named} are missing{more}; the first is"
