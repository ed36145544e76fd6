"""A few files in a folder that together are one model."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Protocol

from codec.errors import UnsupportedError
from codec.files import read_bounded

MAX_FILE_BYTES = 1 << 29
"""Longest file read; a picture with a pixel for each of the most Gaussians is far shorter."""


class Files(Protocol):
    """Files by their names."""

    @property
    def num_bytes(self) -> int:
        """Size of all of them."""

    def read(self, name: str) -> bytes:
        """The file called `name`. Raises a CodecError."""


class ModelFolder:
    """The files in the folder `path`, but not in folders inside it. `what` is for errors."""

    def __init__(self, path: Path, what: str) -> None:
        self._path, self._what = path, what

    @property
    def num_bytes(self) -> int:
        """Size of all files."""
        return sum(path.stat().st_size for path in self._path.iterdir() if path.is_file())

    def read(self, name: str) -> bytes:
        """The file called `name`. Raises CorruptError, or UnsupportedError for a name that leads to
        another folder."""
        if not is_plain_name(name):
            raise UnsupportedError(f"{self._what}: {name[:40]!r} is not the name of a file beside")
        return read_bounded(self._path / name, MAX_FILE_BYTES)


def is_plain_name(name: str) -> bool:
    """Whether `name` names a file without its folder, on every system."""
    return name.isprintable() and not re.search(r"^\.|^$|[/\\:]", name)
