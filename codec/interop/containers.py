"""Files that hold a whole sequence: which reader a file has, and single frames of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from codec.errors import CodecError
from codec.files import read_head
from codec.foreign import fourdgsrecords, splat4d
from codec.foreign.bundle import MAGIC as ZIP_MAGIC
from codec.foreign.fourdgs import FourdgsReader
from codec.foreign.notes import reading
from codec.foreign.splat4d import Splat4dReader
from codec.foreign.tsog import TsogReader
from codec.splats import Splats


class FrameReader(Protocol):
    """Gives the frames of a container, at the least cost in rising order."""

    fps: float

    @property
    def num_frames(self) -> int: ...

    def read(self, frame: int, max_gaussians: int) -> Splats:
        """Raises a CodecError."""


READERS: dict[bytes, Callable[[Path], FrameReader]] = {
    fourdgsrecords.MAGIC: FourdgsReader,
    splat4d.MAGIC: Splat4dReader,
}
"""By the first bytes of a file."""
TSOG_SUFFIX = ".tsog"
"""The name of a file that begins like any ZIP archive."""


@dataclass(frozen=True, slots=True)
class ContainedFrame:
    """A frame of the container at `path`."""

    path: Path
    number: int
    reader: FrameReader

    def __str__(self) -> str:
        return f"{self.path} frame {self.number}"

    @property
    def name(self) -> str:
        """As `Path.name`: of the file alone, and which frame."""
        return f"{self.path.name} frame {self.number}"

    def read(self, max_gaussians: int) -> Splats:
        """Its Gaussians. Raises a CodecError that names it."""
        try:
            with reading(self):
                return self.reader.read(self.number, max_gaussians)
        except CodecError as error:
            raise error.within(self) from error


def contained_frames(path: Path) -> list[ContainedFrame] | None:
    """The frames of the file at `path`; None if it is no container of a sequence. Raises a
    CodecError that names the file."""
    if not path.is_file():
        return None
    head, _ = read_head(path, max(map(len, READERS)))
    readers = dict(READERS)
    if path.suffix.lower() == TSOG_SUFFIX:
        readers[ZIP_MAGIC] = TsogReader
    for magic, open_reader in readers.items():
        if head.startswith(magic):
            try:
                with reading(path):
                    reader = open_reader(path)
            except CodecError as error:
                raise error.within(path) from error
            return [ContainedFrame(path, number, reader) for number in range(reader.num_frames)]
    return None
