"""Cameras by their names: which to open, and how a line names several."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

from codec.console import listed
from trainer.errors import CaptureError

MAX_NAMED = 4
"""Cameras named in a line."""


def named(names: Sequence[str]) -> str:
    """The first of the names, and how many more there are."""
    return listed(names, MAX_NAMED)


@dataclass(frozen=True, slots=True)
class CameraChoice:
    """Which cameras of a capture to open."""

    without: tuple[str, ...] = ()
    """Names of cameras to leave out."""
    only: frozenset[str] | None = None
    """Names of the cameras to open, those that exist; None for all."""

    def keep(self, names: Collection[str], root: Path) -> list[str]:
        """The names of the cameras to open, in their order. Raises CaptureError for a camera to
        leave out that does not exist, and where none is left."""
        for name in self.without:
            if name not in names:
                raise CaptureError(
                    f"{root}: has no camera {name!r} to leave out; it has {named(sorted(names))}"
                )
        kept = [name for name in names if not self.leaves_out(name)]
        if not kept:
            asked = f"; it has {named(sorted(names))}"
            raise CaptureError(f"{root}: has none of the cameras that are asked for{asked}")
        return kept

    def leaves_out(self, name: str) -> bool:
        """Whether a camera of this name is not opened."""
        return name in self.without or (self.only is not None and name not in self.only)


ALL_CAMERAS = CameraChoice()
