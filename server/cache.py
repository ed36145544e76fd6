"""Objects in memory: read once in a thread, bounded in bytes, the least recently used goes."""

from __future__ import annotations

import asyncio
from collections import OrderedDict
from dataclasses import dataclass
from functools import partial

from codec.stream.integrity import CheckedObject
from codec.stream.manifest import Part
from codec.stream.plainrecord import ZSTD, inflates_whole

from .http.content import IMMUTABLE, Content
from .http.memoryfile import SUPPORTED, MemoryFile
from .library import ServedStream
from .metrics import Metrics

Key = tuple[int, int, Part]
"""Generation of the stream, segment and part."""

FILE_BYTES = 16 * 1024
"""Objects of so many bytes are sent from a file in memory; shorter ones cost less by a copy."""

MAX_FILES = 4096
"""Files in memory at the same time: each is a descriptor."""


@dataclass(slots=True)
class CachedObject:
    """An object, and what a request for it is answered with once there was one."""

    checked: CheckedObject
    content: Content | None = None

    @property
    def size_bytes(self) -> int:
        """What it takes of the memory: twice its length if it is there as a file too."""
        filed = self.content is not None and isinstance(self.content.data, MemoryFile)
        return len(self.checked.data) * (2 if filed else 1)


class ObjectCache:
    """Holds at most `capacity_bytes` of objects.

    A play or a response keeps the objects that it is sending, even those that were dropped here.
    """

    def __init__(self, capacity_bytes: int, metrics: Metrics) -> None:
        self._capacity_bytes = capacity_bytes
        self._metrics = metrics
        self._objects: OrderedDict[Key, CachedObject] = OrderedDict()
        self._loading: dict[Key, asyncio.Task[CachedObject]] = {}
        self._num_files = 0
        self.size_bytes = 0

    async def load(self, stream: ServedStream, segment: int, part: Part) -> CheckedObject:
        """The object of (segment, part), which `stream` has. Raises CodecError for a bad file."""
        return (await self._cached(stream, segment, part)).checked

    def content(self, stream: ServedStream, segment: int, part: Part) -> Content | None:
        """The object as an answer, if one was made already."""
        key = (stream.generation, segment, part)
        found = self._objects.get(key)
        if found is None or found.content is None:
            return None
        self._metrics.cache_hits.add(1)
        self._objects.move_to_end(key)
        return found.content

    async def load_content(self, stream: ServedStream, segment: int, part: Part) -> Content:
        """The object as an answer. Raises CodecError for a bad file."""
        cached = await self._cached(stream, segment, part)
        if cached.content is None:
            before_bytes = cached.size_bytes
            data, name = cached.checked.data, str(part)
            filed = SUPPORTED and len(data) >= FILE_BYTES and self._num_files < MAX_FILES
            content = Content(
                MemoryFile(data) if filed else data,
                len(data),
                stream.object_sha256(segment, part),
                "application/octet-stream",
                IMMUTABLE,
                coding=ZSTD if inflates_whole(data, cached.checked.entries) else "",
                count=partial(self._count, name),
            )
            cached.content = content
            key = (stream.generation, segment, part)
            if self._objects.get(key) is cached:
                self._num_files += filed
                self.size_bytes += cached.size_bytes - before_bytes
                self._shrink()
        return cached.content

    def _count(self, layer: str, num_bytes: int) -> None:
        self._metrics.layer_bytes.add(num_bytes, "object", layer)

    async def _cached(self, stream: ServedStream, segment: int, part: Part) -> CachedObject:
        key = (stream.generation, segment, part)
        found = self._objects.get(key)
        if found is not None:
            self._metrics.cache_hits.add(1)
            self._objects.move_to_end(key)
            return found
        task = self._loading.get(key)
        if task is None:
            self._metrics.cache_misses.add(1)
            task = asyncio.create_task(self._load(key, stream))
            # Somebody must look at a failure, even if all who waited have gone.
            task.add_done_callback(lambda done: done.cancelled() or done.exception())
            self._loading[key] = task
        # A client that goes away must not break the load for the others that wait for it.
        return await asyncio.shield(task)

    async def _load(self, key: Key, stream: ServedStream) -> CachedObject:
        try:
            loaded = CachedObject(await asyncio.to_thread(stream.read_object, *key[1:]))
        finally:
            del self._loading[key]
        if loaded.size_bytes <= self._capacity_bytes:
            self._objects[key] = loaded
            self.size_bytes += loaded.size_bytes
        self._shrink()
        return loaded

    def _shrink(self) -> None:
        while self.size_bytes > self._capacity_bytes:
            _, dropped = self._objects.popitem(last=False)
            self.size_bytes -= dropped.size_bytes
            if dropped.content is not None and isinstance(dropped.content.data, MemoryFile):
                self._num_files -= 1
        self._metrics.cache_bytes.set(self.size_bytes)
