"""The files of a sequence: one for each frame, in order of number."""

from __future__ import annotations

import re
from itertools import pairwise
from pathlib import Path

from codec.errors import InvalidError
from codec.interop.formats import READ, has_known_suffix


def number_of(path: Path) -> int | None:
    """The last number in the name of `path`, without its suffix; None if it has none."""
    digits = re.findall(r"[0-9]+", path.stem)
    return int(digits[-1]) if digits else None


def find_files(source: Path) -> list[Path]:
    """The file `source`, or those of the folder `source` by the last number in their names.

    Numbers may begin anywhere and go on by any step that stays the same. Raises InvalidError for a
    folder without files of Gaussians, a name without a number, two names with the same number, a
    number that is missing, or a name of something else than a file.
    """
    if not source.is_dir():
        return [source]
    numbered: dict[int, Path] = {}
    for path in sorted(source.iterdir()):
        if path.name.startswith(".") or not has_known_suffix(path):
            continue
        number = number_of(path)
        if number is None:
            raise InvalidError(f"{path}: its name has no number to sort a sequence by")
        if not path.is_file():
            what = "a broken link" if path.is_symlink() else "not a regular file"
            raise InvalidError(f"{path} is {what}; replace or remove it")
        first = numbered.setdefault(number, path)
        if first is not path:
            raise InvalidError(f"{source}: {first.name} and {path.name} have the same number")
    if not numbered:
        raise InvalidError(f"{source}: no file of Gaussians in this folder ({READ})")
    numbers = sorted(numbered)
    step = min((b - a for a, b in pairwise(numbers)), default=1)
    for a, b in pairwise(numbers):
        if b - a != step:
            raise InvalidError(
                f"{source}: number {a + step} is missing between {numbered[a].name} and "
                f"{numbered[b].name}"
            )
    return [numbered[number] for number in numbers]
