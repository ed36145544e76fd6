"""An entry of the library: a stream that can be served, or why it cannot be.

Rule: while its files keep their stamps they are not read again.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Awaitable, Callable
from dataclasses import dataclass

from codec.errors import CodecError, CorruptError, UnreadableError
from codec.storage.storage import Stamp, Storage
from codec.stream.integrity import MAX_INDEX_BYTES
from codec.stream.manifest import MANIFEST_NAME, MAX_MANIFEST_BYTES, SEGMENTS_NAME, object_name
from codec.stream.reader import read_stream_file
from codec.stream.segment import INDEX_NAME

from .servedstream import ServedStream
from .streamview import StreamView, continued, index_of, is_continued, view_of

log = logging.getLogger(__name__)

FILES = (MANIFEST_NAME, INDEX_NAME)
"""Files whose stamps show whether a stream has changed; a folder with the first of them is a
stream."""

MAX_REASON_CHARS = 300

UNREADABLE = "the stream cannot be read; see the server's log"
BUG = "internal server error; see the server's log"

Stamps = tuple[Stamp | None, ...]


def one_line(text: str) -> str:
    """`text` without what a terminal or a log would take for more than a line of letters."""
    shown = "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text[:MAX_REASON_CHARS])
    return shown + ("..." if len(text) > MAX_REASON_CHARS else "")


class Entry:
    """One name. Its methods block."""

    def __init__(
        self,
        name: str,
        path: str,
        storage: Storage,
        look: Callable[[], Awaitable[None]],
    ) -> None:
        """path: where it lies in the root. look: looks at this stream again, for the tasks that
        wait for its growth."""
        self.path = path
        self.stream: ServedStream | None = None
        self.reason = ""
        """Why there is no stream, in a line without the paths of this machine."""
        self._name = name
        self._storage = storage
        self._look_again = look
        self._lock = threading.Lock()
        self._stamps: Stamps | None = None
        self._lacking: LackingObject | None = None
        self._said: object = None

    def refuse(self, reason: str) -> None:
        """Says that nothing is served under this name, whatever its files hold."""
        self._drop(reason, reason)

    def peek(self) -> bool:
        """Looks at the files on its own; gives whether `stream` or its view is another now."""
        if not self._lock.acquire(blocking=False):
            return False  # another thread looks
        try:
            stamps = tuple(self._storage.stamp(path) for path in FILES)
            # The library's scan handles appearing and vanishing streams, and an unreadable root.
            return stamps[0] is not None and self._look(stamps)
        except UnreadableError:
            return False
        finally:
            self._lock.release()

    def look(self, stamps: Stamps) -> None:
        """Takes in what has changed; `stamps` were taken of FILES just now."""
        with self._lock:
            self._look(stamps)

    def _look(self, stamps: Stamps) -> bool:
        before = (self.stream, None if self.stream is None else self.stream.view)
        try:
            if stamps == self._stamps and not self._is_due():
                return False
            self._stamps, self._lacking = stamps, None
            self._take()
        except UnreadableError as error:
            self._stamps = None  # it may be well at the next look
            if self.stream is None:
                self._drop(UNREADABLE, str(error))
            else:
                self._say(logging.WARNING, "keeps its last readable state", str(error), UNREADABLE)
        except CodecError as error:
            name = self._storage.name
            reason = str(error).removeprefix(f"{name}/").removeprefix(f"{name}: ")
            self._drop(reason, reason)
        except Exception:
            # An unexpected error in one stream must not keep the others from being followed.
            if self.reason != BUG:
                log.exception("%s is not served", one_line(self._storage.name))
            self.stream, self.reason = None, BUG
        return before != (self.stream, None if self.stream is None else self.stream.view)

    def _is_due(self) -> bool:
        """Whether it is worth reading though the files look the same."""
        return self._lacking is not None and self._lacking.has_come(self._storage)

    def _take(self) -> None:
        """Reads the files, and makes of them what they are."""
        manifest_json = read_stream_file(self._storage, MANIFEST_NAME, MAX_MANIFEST_BYTES)
        # After the manifest: one that says finished then goes with a whole index.
        index = read_stream_file(self._storage, INDEX_NAME, MAX_INDEX_BYTES)
        if self._stamps is None or self._storage.stamp(MANIFEST_NAME) != self._stamps[0]:
            self._stamps = None  # replaced meanwhile: the two may not belong together
            return
        if self.stream is not None and is_continued(self.stream.view, manifest_json, index):
            self._grow(self.stream, manifest_json, index)
        else:
            self._open(manifest_json, index)

    def _open(self, manifest_json: bytes, index: bytes) -> None:
        view = view_of(manifest_json, index)
        self._lacking = first_lacking(self._storage, view)
        if self._lacking is not None:
            if not view.manifest.live:
                raise CorruptError(f"{self._lacking}; is the copy incomplete?")
            view = view_of(manifest_json, index_of(view, self._lacking.segment))
        known = self.stream is not None
        self.stream = ServedStream(self._name, self._storage, view, self._look_again)
        self.reason = ""
        what = "was replaced" if known else "is served"
        self._say(logging.INFO, what, f"{view.num_frames} frames{', live' * view.manifest.live}")

    def _grow(self, stream: ServedStream, manifest_json: bytes, index: bytes) -> None:
        before = stream.view
        try:
            view = continued(before, manifest_json, index)
        except CodecError as error:
            # What was there before it broke can still be served.
            self._say(logging.WARNING, "no longer grows", str(error))
            return
        self._lacking = first_lacking(self._storage, view, before.num_segments)
        if self._lacking is not None:
            there = index_of(view, self._lacking.segment)
            view = continued(before, before.manifest_json, there)
        stream.view = view
        if before.manifest.live and not view.manifest.live:
            self._say(logging.INFO, "is finished", f"{view.num_frames} frames")

    def _drop(self, reason: str, logged_reason: str) -> None:
        """Removes the stream. reason: for clients. logged_reason: for the log."""
        self.stream, self.reason = None, one_line(reason)
        self._say(logging.WARNING, "is not served", logged_reason, reason)

    def leave(self) -> None:
        """Says that there is nothing under this name any more."""
        self._say(logging.INFO, "was removed", "")

    def _say(self, level: int, what: str, more: str, same: object = None) -> None:
        """A line in the log, but not the one that was said last. same: what to know it by, if
        `more` is another each time."""
        key = (what, same or more)
        if key != self._said:
            self._said = key
            place, end = one_line(self._storage.name), f": {one_line(more)}" if more else ""
            log.log(level, "%s %s%s", place, what, end)


FEW_SEGMENTS = 8
"""Up to so many segments are looked at object by object; for more, all are listed at once."""


@dataclass(frozen=True, slots=True)
class LackingObject:
    """The first object that is not there as the index says: a copy may be half done."""

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
    listed = dict(storage.sizes(SEGMENTS_NAME)) if len(records) > FEW_SEGMENTS else None
    for record in records:
        for part, size_bytes in zip(parts, record.part_bytes, strict=True):
            path = object_name(record.segment, part)
            found_bytes = _size(storage, path) if listed is None else listed.get(path)
            if found_bytes != size_bytes:
                return LackingObject(record.segment, path, size_bytes, found_bytes)
    return None


def _size(storage: Storage, path: str) -> int | None:
    stamp = storage.stamp(path)
    return stamp.size_bytes if stamp is not None and storage.holds(path) else None
