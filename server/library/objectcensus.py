"""Whether the objects are there that an index names: a copy may be half done."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from codec.storage.storage import Storage
from codec.stream.manifest import SEGMENTS_NAME, object_name

from .streamview import StreamView

FEW_SEGMENTS = 8
"""Up to so many segments are looked at object by object; for more, all are listed at once."""


@dataclass(frozen=True, slots=True)
class LackingObject:
    """The first object that is not there as the index says."""

    segment: int
    path: str
    size_bytes: int
    """As the index says."""
    found_bytes: int | None
    """None if there is nothing."""

    def __str__(self) -> str:
        if self.found_bytes is None:
            return f"{self.path} is missing"
        return f"{self.path} has {self.found_bytes} bytes, not {self.size_bytes}"

    def has_come(self, storage: Storage) -> bool:
        """Whether it is there by now."""
        return _size(storage, self.path) == self.size_bytes


def first_lacking(
    storage: Storage, view: StreamView, first_segment: int = 0
) -> LackingObject | None:
    """The first object that is missing or has another size, of the segments from `first_segment`
    on; None if all are there. Checks sizes only: the content is checked when an object is read.
    Raises UnreadableError."""
    records, parts = view.records[first_segment:], view.manifest.parts
    find = _size_finder(storage, len(records))
    for record in records:
        for part, size_bytes in zip(parts, record.part_bytes, strict=True):
            path = object_name(record.segment, part)
            found_bytes = find(path)
            if found_bytes != size_bytes:
                return LackingObject(record.segment, path, size_bytes, found_bytes)
    return None


def _size_finder(storage: Storage, num_segments: int) -> Callable[[str], int | None]:
    if num_segments > FEW_SEGMENTS:
        return dict(storage.sizes(SEGMENTS_NAME)).get
    return partial(_size, storage)


def _size(storage: Storage, path: str) -> int | None:
    stamp = storage.stamp(path)
    return stamp.size_bytes if stamp is not None and storage.holds(path) else None
