"""From what the user typed to a storage."""

from __future__ import annotations

from pathlib import Path

from codec.errors import InvalidError

from .folder import FolderStorage
from .objectstore import SCHEMES, open_store
from .storage import Storage

Place = str | Path | Storage
"""A folder, a URL such as `s3://bucket/stream`, or what `open_storage` made of one."""


def open_storage(place: Place) -> Storage:
    """The storage at `place`. Raises InvalidError for a URL that cannot be one."""
    if isinstance(place, Storage):
        return place
    scheme, separator, _ = str(place).partition("://")
    if isinstance(place, Path) or not separator:
        return FolderStorage(Path(place))
    if scheme.lower() not in SCHEMES:
        names = ", ".join(f"{name}://" for name in SCHEMES)
        raise InvalidError(f"{place}: streams are read from folders, or from {names}")
    return open_store(place)
