"""Objects in memory: read once in a thread, bounded in bytes, the least recently used goes."""

from __future__ import annotations

import asyncio
from collections import OrderedDict
from dataclasses import dataclass, replace
from functools import partial

from multidict import CIMultiDict

from codec.stream.integrity import CheckedObject
from codec.stream.manifest import Part
from codec.stream.plainrecord import ZSTD, inflates_whole
from server.exchange.content import IMMUTABLE, OBJECT_TYPE, Content, respond
from server.exchange.request import Request
from server.exchange.response import Response
from server.library import ServedStream
from server.operate.prometheus import Metrics

Key = tuple[int, int, Part]
"""Generation of the stream, segment and part."""


@dataclass(slots=True)
class CachedObject:
    """An object, and what a request for it is answered with once there was one."""

    key: Key
    stream: ServedStream
    checked: CheckedObject
    content: Content | None = None
    path: str = ""
    """Path of the URL of `response`."""
    response: Response | None = None
    """The response to a plain GET."""


class ObjectCache:
    """Holds at most `capacity_bytes` of objects.

    A play or a response keeps the objects that it is sending, even those that were dropped here.
    """

    def __init__(self, capacity_bytes: int, metrics: Metrics) -> None:
        self._capacity_bytes = capacity_bytes
        self._metrics = metrics
        self._objects: OrderedDict[Key, CachedObject] = OrderedDict()
        self._loading: dict[Key, asyncio.Task[CachedObject]] = {}
        self._ready: dict[str, CachedObject] = {}  # by path
        self.size_bytes = 0

    async def load(self, stream: ServedStream, segment: int, part: Part) -> CheckedObject:
        """The object of (segment, part), which `stream` has. Raises CodecError for a bad file."""
        return (await self._cached(stream, segment, part)).checked

    def response(self, path: str) -> Response | None:
        """The response to a plain GET of `path`, if it was prepared."""
        found = self._ready.get(path)
        if found is None or found.response is None:
            return None
        if found.stream.gone:
            del self._ready[path]
            return None
        self._metrics.cache_hits.add(1)
        self._metrics.layer_bytes.add(len(found.checked.data), "object", str(found.key[2]))
        self._objects.move_to_end(found.key)
        return found.response

    def make_ready(self, path: str, stream: ServedStream, segment: int, part: Part) -> None:
        """Makes what a plain GET of `path`, which is the object's, gets from now on."""
        found = self._objects.get((stream.generation, segment, part))
        if found is None or found.content is None or found.response is not None:
            return
        uncounted = replace(found.content, count=None)
        response = respond(Request("GET", path, "", "", CIMultiDict()), uncounted)
        response.prepared = response.head_fields()
        found.path, found.response = path, response
        self._ready[path] = found

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
            self._objects.move_to_end(key)
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
            loaded = CachedObject(
                key, stream, await asyncio.to_thread(stream.read_object, *key[1:])
            )
        finally:
            del self._loading[key]
        if len(loaded.checked.data) <= self._capacity_bytes:
            self._objects[key] = loaded
            self.size_bytes += len(loaded.checked.data)
        self._shrink()
        return loaded

    def _shrink(self) -> None:
        while self.size_bytes > self._capacity_bytes:
            _, dropped = self._objects.popitem(last=False)
            self.size_bytes -= len(dropped.checked.data)
            # Another stream may have taken the place of this one.
            if self._ready.get(dropped.path) is dropped:
                del self._ready[dropped.path]
        self._metrics.cache_bytes.set(self.size_bytes)
