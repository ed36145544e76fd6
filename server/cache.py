"""Objects in memory: read once in a thread, bounded in bytes, the least recently used goes."""

from __future__ import annotations

import asyncio
from collections import OrderedDict

from codec.stream.integrity import CheckedObject
from codec.stream.manifest import Part

from .library import ServedStream
from .metrics import Metrics

Key = tuple[int, int, Part]
"""Generation of the stream, segment and part."""


class ObjectCache:
    """Holds at most `capacity_bytes` of objects.

    A play or a response keeps the objects that it is sending, even those that were dropped here.
    """

    def __init__(self, capacity_bytes: int, metrics: Metrics) -> None:
        self._capacity_bytes = capacity_bytes
        self._metrics = metrics
        self._objects: OrderedDict[Key, CheckedObject] = OrderedDict()
        self._loading: dict[Key, asyncio.Task[CheckedObject]] = {}
        self.size_bytes = 0

    async def load(self, stream: ServedStream, segment: int, part: Part) -> CheckedObject:
        """The object of (segment, part), which `stream` has. Raises CodecError for a bad file."""
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

    async def _load(self, key: Key, stream: ServedStream) -> CheckedObject:
        try:
            loaded = await asyncio.to_thread(stream.read_object, *key[1:])
        finally:
            del self._loading[key]
        if len(loaded.data) <= self._capacity_bytes:
            self._objects[key] = loaded
            self.size_bytes += len(loaded.data)
        while self.size_bytes > self._capacity_bytes:
            _, dropped = self._objects.popitem(last=False)
            self.size_bytes -= len(dropped.data)
        self._metrics.cache_bytes.set(self.size_bytes)
        return loaded
