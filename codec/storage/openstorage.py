"""From what the user typed to a storage."""

from __future__ import annotations

from pathlib import Path

from codec.errors import InvalidError

from .credentials import without_credentials
from .folder import FolderStorage
from .objectstore import SCHEMES, open_store
from .storage import Storage

Target = str | Path
"""A folder, or a URL such as `s3://bucket/stream`."""

Place = Target | Storage
"""A target, or what `open_storage` made of one."""


def is_url(target: Target) -> bool:
    """Whether `target` names something else than a file or folder of this machine."""
    return not isinstance(target, Path) and "://" in target


def parse_target(text: str) -> Target:
    """What the user typed: a Path, or a URL as it is."""
    return text if is_url(text) else Path(text)


def check_url(url: str) -> None:
    """Raises InvalidError for a URL of no object store."""
    if url.partition("://")[0].lower() not in SCHEMES:
        names = ", ".join(f"{name}://" for name in SCHEMES)
        name = without_credentials(url)
        raise InvalidError(f"{name}: choose a folder on this machine, or a URL of {names}")


def open_storage(place: Place) -> Storage:
    """The storage at `place`. Raises InvalidError for a URL that cannot be one."""
    if isinstance(place, Storage):
        return place
    if not is_url(place):
        return FolderStorage(Path(place))
    check_url(str(place))
    return open_store(str(place))
