"""Objects in memory: read once, in a thread, however many ask."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from functools import partial

from codec.stream.integrity import CheckedObject
from codec.stream.manifest import Part
from codec.stream.plainrecord import ZSTD, inflates_whole
from server.http.content import IMMUTABLE, OBJECT_TYPE, Content
from server.library import ServedStream
from server.operate.prometheus import Metrics

from .bytecache import ByteCache

Key = tuple[int, int, Part]
"""Generation of the stream, segment and part."""


@dataclass(slots=True)
class CachedObject:
    """An object, and its content as a URL gives it once there was a request."""

    checked: CheckedObject
    content: Content | None = None


class ObjectCache:
    """The objects of all streams; a play or a response keeps those that it is sending."""

    def __init__(self, capacity_bytes: int, metrics: Metrics) -> None:
        self._metrics = metrics
        self._objects = ByteCache[Key, CachedObject](capacity_bytes)
        self._loading: dict[Key, asyncio.Task[CachedObject]] = {}

    @property
    def size_bytes(self) -> int:
        return self._objects.size_bytes

    async def load(self, stream: ServedStream, segment: int, part: Part) -> CheckedObject:
        """The object of (segment, part), which `stream` has. Raises CodecError for a bad file."""
        return (await self._cached(stream, segment, part)).checked

    def content(self, stream: ServedStream, segment: int, part: Part) -> Content | None:
        """The object as an answer, if one was made already."""
        found = self._objects.get((stream.generation, segment, part))
        if found is None or found.content is None:
            return None
        self._metrics.cache_hits.add(1)
        return found.content

    async def load_content(self, stream: ServedStream, segment: int, part: Part) -> Content:
        """The object as an answer. Raises CodecError for a bad file."""
        cached = await self._cached(stream, segment, part)
        if cached.content is None:
            data = cached.checked.data
            cached.content = Content(
                data,
                stream.object_sha256(segment, part),
                OBJECT_TYPE,
                IMMUTABLE,
                coded={ZSTD: data} if inflates_whole(data, cached.checked.entries) else {},
                count=partial(self._count, str(part)),
            )
        return cached.content

    def _count(self, layer: str, num_bytes: int) -> None:
        self._metrics.layer_bytes.add(num_bytes, "object", layer)

    async def _cached(self, stream: ServedStream, segment: int, part: Part) -> CachedObject:
        key = (stream.generation, segment, part)
        found = self._objects.get(key)
        if found is not None:
            self._metrics.cache_hits.add(1)
            return found
        task = self._loading.get(key)
        if task is None:
            self._metrics.cache_misses.add(1)
            task = asyncio.create_task(self._load(key, stream))
            # The exception must be retrieved even if all waiting tasks were cancelled.
            task.add_done_callback(lambda done: done.cancelled() or done.exception())
            self._loading[key] = task
        # A client that goes away must not break the load for the others that wait for it.
        return await asyncio.shield(task)

    async def _load(self, key: Key, stream: ServedStream) -> CachedObject:
        try:
            loaded = CachedObject(await asyncio.to_thread(stream.read_object, *key[1:]))
        finally:
            del self._loading[key]
        self._objects.keep(key, loaded, len(loaded.checked.data))
        self._metrics.cache_bytes.set(self.size_bytes)
        return loaded
