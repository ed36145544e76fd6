"""What is kept in memory, bounded in bytes: objects as they lie on disk, the records of plays, and
sound as it is answered. The least recently used goes."""

from __future__ import annotations

import asyncio
import hashlib
from collections import OrderedDict
from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from functools import partial
from typing import Generic, Protocol, TypeVar

from codec.errors import CodecError
from codec.stream.integrity import CheckedObject
from codec.stream.manifest import SKIP_MAPS, Part, keyframe_part
from codec.stream.playrecord import KeyframeRecord, SliceRecord, encode_record
from server.abr.decisioncontext import SendSlices
from server.http.content import IMMUTABLE, OBJECT_TYPE, REVALIDATE, Content
from server.library import ServedStream
from server.operate.prometheus import Metrics


class Held(Protocol):
    """What a cache holds."""

    @property
    def data(self) -> bytes: ...


K = TypeVar("K", bound=Hashable)
V = TypeVar("V", bound=Held)


class ByteCache(Generic[K, V]):
    """Holds values of at most `capacity_bytes` in all. What was dropped here lives on where it is
    in use."""

    def __init__(self, capacity_bytes: int) -> None:
        self._capacity_bytes = capacity_bytes
        self._held: OrderedDict[K, V] = OrderedDict()
        self.size_bytes = 0

    def get(self, key: K) -> V | None:
        found = self._held.get(key)
        if found is not None:
            self._held.move_to_end(key)
        return found

    def keep(self, key: K, value: V) -> None:
        """Holds `value` in place of what had this key, unless it is too large by itself."""
        before = self._held.pop(key, None)
        self.size_bytes -= len(before.data) if before is not None else 0
        if len(value.data) > self._capacity_bytes:
            return
        self._held[key] = value
        self.size_bytes += len(value.data)
        while self.size_bytes > self._capacity_bytes:
            _, dropped = self._held.popitem(last=False)
            self.size_bytes -= len(dropped.data)


@dataclass(frozen=True, slots=True)
class ObjectContent(Content):
    """An object as an answer, and what a play takes of it."""

    checked: CheckedObject = field(kw_only=True)


class ObjectCache:
    """The objects of all streams, also those of sound; a play or a response keeps those that it is
    sending."""

    def __init__(self, capacity_bytes: int, metrics: Metrics) -> None:
        self._metrics = metrics
        self._objects = ByteCache[tuple[object, ...], Content](capacity_bytes)
        self._loading: dict[tuple[object, ...], asyncio.Task[Content]] = {}

    @property
    def size_bytes(self) -> int:
        return self._objects.size_bytes

    def content(self, stream: ServedStream, segment: int, part: Part) -> Content | None:
        """The object as an answer, if it is in memory."""
        return self._found((stream.generation, segment, part))

    async def load(self, stream: ServedStream, segment: int, part: Part) -> ObjectContent:
        """The object of (segment, part), which `stream` has. Raises CodecError for a bad file."""
        key = stream.generation, segment, part
        found = await self._cached(key, partial(self._read, stream, segment, part))
        assert isinstance(found, ObjectContent)
        return found

    async def load_sound(self, stream: ServedStream, segment: int, name: str) -> Content:
        """The object that `stream.has_sound`, as an answer. Raises a CodecError for a bad file."""
        # Before the content: what is replaced between the two is read again at the next request.
        stamp = await asyncio.to_thread(stream.sound_stamp, segment, name)
        key = stream.generation, segment, name, stamp
        return await self._cached(key, partial(_read_sound, stream, segment, name))

    def _found(self, key: tuple[object, ...]) -> Content | None:
        found = self._objects.get(key)
        if found is not None:
            self._metrics.cache_hits.add(1)
        return found

    async def _cached(self, key: tuple[object, ...], read: Callable[[], Content]) -> Content:
        found = self._found(key)
        if found is not None:
            return found
        task = self._loading.get(key)
        if task is None:
            self._metrics.cache_misses.add(1)
            task = self._loading[key] = asyncio.create_task(self._load(key, read))
            # The exception must be retrieved even if all waiting tasks were cancelled.
            task.add_done_callback(lambda done: done.cancelled() or done.exception())
        # A client that goes away must not break the load for the others that wait for it.
        return await asyncio.shield(task)

    async def _load(self, key: tuple[object, ...], read: Callable[[], Content]) -> Content:
        try:
            loaded = await asyncio.to_thread(read)
        finally:
            del self._loading[key]
        self._objects.keep(key, loaded)
        self._metrics.cache_bytes.set(self.size_bytes)
        return loaded

    def _read(self, stream: ServedStream, segment: int, part: Part) -> ObjectContent:
        checked = stream.read_object(segment, part)
        return ObjectContent(
            checked.data,
            stream.object_sha256(segment, part),
            OBJECT_TYPE,
            IMMUTABLE,
            count=lambda sent: self._metrics.layer_bytes.add(sent, "object", str(part)),
            checked=checked,
        )


def _read_sound(stream: ServedStream, segment: int, name: str) -> Content:
    data = stream.read_sound(segment, name)
    return Content(data, hashlib.sha256(data).hexdigest(), OBJECT_TYPE, REVALIDATE)


RecordKey = tuple[int, int, int, int]
"""Generation of the stream, birth, first and end layer."""


@dataclass(frozen=True, slots=True)
class CodedRecord:
    """A record as it goes out, and what is in it."""

    data: bytes
    parts: tuple[Part, ...]
    packet_bytes: tuple[int, ...]
    """Bytes of the packets of each part."""


class RecordCache:
    """Makes records, and keeps those that are asked for."""

    def __init__(self, objects: ObjectCache, capacity_bytes: int) -> None:
        self._objects = objects
        self._records = ByteCache[RecordKey, CodedRecord](capacity_bytes)

    async def slices(
        self, stream: ServedStream, send: SendSlices
    ) -> tuple[list[CodedRecord], CodecError | OSError | None]:
        """A record for each slice of `send`, with its skip map where it has layer 0; or for those
        before a file that is bad, and what is wrong with it."""
        first, end, generation = send.first_layer, send.end_layer, stream.generation
        coded = []
        try:
            for birth in send.births:
                key = generation, birth, first, end
                coded.append(self._records.get(key) or await self._slice(key, stream))
        except (CodecError, OSError) as error:
            return coded, error
        return coded, None

    async def _slice(self, key: RecordKey, stream: ServedStream) -> CodedRecord:
        _, birth, first_layer, end_layer = key
        segment = stream.view.manifest.segment_of(birth)
        layers: list[Part] = [*range(first_layer, end_layer)]
        parts = layers if first_layer else [*layers, SKIP_MAPS]
        packets = [
            (await self._objects.load(stream, segment, part)).checked.packet(birth)
            for part in parts
        ]
        skip_map = packets[-1] if len(parts) > len(layers) else None
        record = SliceRecord(birth, tuple(packets[: len(layers)]), skip_map, first_layer)
        coded = _coded(record, parts, packets)
        self._records.keep(key, coded)
        return coded

    async def keyframes(
        self,
        stream: ServedStream,
        frame: int,
        first_layer: int,
        most_bytes: int,
        end_layer: int,
    ) -> CodedRecord:
        """The keyframes at `frame` of layers from `first_layer` on: as many as have not much more
        than `most_bytes`, up to `end_layer`."""
        segment = stream.view.manifest.segment_of(frame)
        parts, packets = list[Part](), list[bytes]()
        for layer in range(first_layer, end_layer):
            part = keyframe_part(layer)
            parts.append(part)
            found = await self._objects.load(stream, segment, part)
            packets.append(found.checked.packet(frame))
            if sum(map(len, packets)) >= most_bytes:
                break
        record = KeyframeRecord(frame, first_layer, tuple(packets))
        return _coded(record, parts, packets)


def _coded(
    record: SliceRecord | KeyframeRecord, parts: list[Part], packets: list[bytes]
) -> CodedRecord:
    return CodedRecord(encode_record(record), tuple(parts), tuple(map(len, packets)))
