"""From where the user wants a stream to a place where it can grow."""

from __future__ import annotations

from pathlib import Path

from .growingfolder import GrowingFolder
from .growingplace import GrowingPlace, Shape
from .growingstore import GrowingStore
from .objectstore import open_store
from .openstorage import Target, check_url, is_url


def open_growing(target: Target, shape: Shape) -> GrowingPlace:
    """The growing place at `target`; nothing is written yet. Raises InvalidError for a URL that
    cannot be one."""
    if not is_url(target):
        return GrowingFolder(Path(target), shape)
    check_url(str(target))
    return GrowingStore(open_store(str(target), patient=True), shape)
