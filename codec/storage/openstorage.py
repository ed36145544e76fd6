"""From what the user typed, a folder or a URL, to a storage."""

from __future__ import annotations

from pathlib import Path

from tyro.constructors import PrimitiveConstructorSpec

from .folder import FolderStorage, GrowingFolder
from .growingstore import GrowingStore
from .objectstore import open_store
from .storage import GrowingPlace, Shape, Storage

Target = str | Path
"""A folder, or a URL such as `s3://bucket/stream`."""

Place = Target | Storage
"""A target, or what `open_storage` made of one."""


def is_url(target: Target) -> bool:
    """Whether `target` names something else than a file or folder of this machine."""
    return not isinstance(target, Path) and "://" in target


def parse_target(text: str) -> Target:
    """An argument of a command: a Path, or a URL as typed."""
    return text if is_url(text) else Path(text)


def open_storage(place: Place) -> Storage:
    """The storage at `place`. Raises InvalidError for a URL that cannot be one."""
    if isinstance(place, Storage):
        return place
    return open_store(str(place)) if is_url(place) else FolderStorage(Path(place))


def open_growing(target: Target, shape: Shape) -> GrowingPlace:
    """The storage at `target`, to be written to; nothing is written yet. Raises InvalidError for a
    URL that cannot be one."""
    return (
        GrowingStore(str(target), shape) if is_url(target) else GrowingFolder(Path(target), shape)
    )


def target_named(metavar: str) -> PrimitiveConstructorSpec[Target | None]:
    """To be put into `Annotated`: tyro itself would make a Path of a URL."""
    return PrimitiveConstructorSpec(
        nargs=1,
        metavar=metavar,
        instance_from_str=lambda words: parse_target(words[0]),
        is_instance=lambda value: value is None or isinstance(value, str | Path),
        str_from_instance=lambda target: [str(target)],
    )
