"""Files that hold a whole sequence, and single frames of them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from codec.errors import CodecError
from codec.files import read_head
from codec.foreign.bundle import MAGIC as ZIP_MAGIC
from codec.foreign.notes import reading
from codec.foreign.tsog import TsogReader
from codec.splats import Splats

TSOG_SUFFIX = ".tsog"
"""The name of a file that begins like any ZIP archive."""


@dataclass(frozen=True, slots=True)
class ContainedFrame:
    """A frame of the container at `path`."""

    path: Path
    number: int
    reader: TsogReader

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
    if path.suffix.lower() != TSOG_SUFFIX or not path.is_file():
        return None
    if read_head(path, len(ZIP_MAGIC))[0] != ZIP_MAGIC:
        return None
    try:
        with reading(path):
            reader = TsogReader(path)
    except CodecError as error:
        raise error.within(path) from error
    return [ContainedFrame(path, number, reader) for number in range(reader.num_frames)]
