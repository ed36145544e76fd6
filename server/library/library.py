"""The streams that are served: a table of names, never a way from a URL to a file.

Rule: a request finds a stream by its name in the table and an object by its place in the index. No
request looks at the disk for what may be new: `watch` does, for all.
"""

from __future__ import annotations

import asyncio
import logging
import re
import threading
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from codec.errors import SwingsError
from codec.storage.storage import Storage, StorageRoot
from codec.stream.packedlayout import PACKED_SUFFIX
from codec.stream.packedstorage import PackedStorage, open_place

from .entry import FILES, Entry, Stamps, one_line
from .servedstream import ServedStream

log = logging.getLogger(__name__)

STREAM_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,79}")
"""Allowed names of streams: they need no quoting in a URL, a metric or a page."""

MISNAMED = "the name of a stream's folder has only letters, digits, '.', '_' and '-'; rename it"

SAME_NAME = "there is a folder with the name of this packed stream; rename one of them"


@dataclass(frozen=True, slots=True)
class _Found:
    """A stream that a look at the root has found."""

    path: str
    """Path of its folder or its file in the root; empty if it is the root."""
    stamps: Stamps
    is_packed: bool = False
    refusal: str = ""
    """Why it is not served, whatever its files hold."""


class Library:
    """The streams below a root that is a stream itself, or a folder of streams; each is a folder or
    a packed stream.

    What the root is, the first stream that is found there decides. Raises a SwingsError at
    construction if there is no such root.
    """

    def __init__(self, root: Path | str, refresh_s: float) -> None:
        self.streams: dict[str, ServedStream] = {}
        """Streams that can be served, by name."""
        self.broken: dict[str, str] = {}
        """Why the other streams cannot be served, by name: one line without the paths of this
        machine."""
        self._storage = open_place(root)
        self._refresh_s = refresh_s
        self._single: bool | None = None
        self._entries: dict[str, Entry] = {}
        self._scanning = threading.Lock()  # a thread outlives the task that waits for it
        self._looking = asyncio.Lock()
        self._in_trouble = False
        self._storage.check()
        self._scan()
        self._apply()

    async def watch(self) -> None:
        """Looks at the root every refresh_s, until it is cancelled."""
        while True:
            try:
                await self.look()
            except Exception:
                log.exception("scanning %s failed", one_line(self._storage.name))
            await asyncio.sleep(self._refresh_s)

    async def look(self) -> None:
        """Looks at the root now. What is served stays as it is where the root cannot be read."""
        async with self._looking:
            try:
                await asyncio.to_thread(self._scan)
            except (SwingsError, OSError) as error:
                if not self._in_trouble:
                    log.warning("the list of streams stays unchanged: %s", one_line(str(error)))
                self._in_trouble = True
                return
            if self._in_trouble:
                log.warning("%s can be read again", one_line(self._storage.name))
            self._in_trouble = False
            self._apply()

    def _scan(self) -> None:
        """Brings the entries up to date. Blocks. Raises SwingsError if the root cannot be read."""
        with self._scanning:
            found = self._found()
            for name, entry in list(self._entries.items()):
                if name not in found or found[name].path != entry.path:
                    self._entries.pop(name).leave()
            for name, one in sorted(found.items()):
                if name not in self._entries:
                    look, storage = partial(self._peek, name), self._storage_of(one)
                    self._entries[name] = Entry(name, one.path, storage, look)
                entry = self._entries[name]
                refusal = one.refusal or ("" if STREAM_NAME.fullmatch(name) else MISNAMED)
                if refusal:
                    entry.refuse(refusal)
                else:
                    entry.look(one.stamps)

    def _storage_of(self, found: _Found) -> Storage:
        root = self._storage
        if not found.path or not isinstance(root, StorageRoot):
            return root
        return PackedStorage(root, found.path) if found.is_packed else root.below(found.path)

    def _found(self) -> dict[str, _Found]:
        """All that has a manifest, and all packed streams, by name."""
        if self._single is not False:
            stamps = tuple(self._storage.stamp(path) for path in FILES)
            if stamps[0] is not None:
                self._single = True
                return {self._storage.last_name: _Found("", stamps)}
        if not isinstance(self._storage, StorageRoot):
            return {}
        folders = self._storage.folders(FILES)  # raises where the root itself is gone
        if self._single:
            return {}
        found = {name: _Found(name, stamps) for name, stamps in folders.items()}
        for file, stamp in self._storage.files(PACKED_SUFFIX).items():
            name, stamps = file.removesuffix(PACKED_SUFFIX), (stamp,) * len(FILES)
            if name in folders:
                found[file] = _Found(file, stamps, True, SAME_NAME)
            else:
                found[name] = _Found(file, stamps, True)
        if found:
            self._single = False
        return found

    async def _peek(self, name: str) -> None:
        """Looks at one stream, for the tasks that wait for it to grow."""
        entry = self._entries.get(name)
        if entry is not None and await asyncio.to_thread(entry.peek):
            self._apply()

    def _apply(self) -> None:
        """Publishes the results of the last look, and wakes the tasks that wait for growth."""
        before, streams, broken = self.streams, {}, {}
        for name, entry in list(self._entries.items()):
            if entry.stream is not None:
                streams[name] = entry.stream
            elif entry.reason:
                broken[one_line(name)[:80]] = entry.reason
        self.streams, self.broken = streams, broken
        for name, stream in before.items():
            if streams.get(name) is not stream:
                stream.announce(gone=True)
        for stream in streams.values():
            stream.announce()
