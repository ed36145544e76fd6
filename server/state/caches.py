"""What is kept in memory, bounded in bytes: objects as they lie on disk, the records of plays, and
sound as it is answered. The least recently used goes."""

from __future__ import annotations

import asyncio
import hashlib
from collections import OrderedDict
from collections.abc import Hashable
from dataclasses import dataclass
from functools import partial
from typing import Generic, TypeVar

from codec.errors import CodecError
from codec.storage.storage import Stamp
from codec.stream.integrity import CheckedObject
from codec.stream.manifest import MASKS, Part, snapshot_part
from codec.stream.plainrecord import ZSTD, PlainRecordEncoder, inflates_whole
from codec.stream.playrecord import SliceRecord, SnapshotRecord, encode_record
from server.abr.decisioncontext import SendSlices
from server.http.content import IMMUTABLE, OBJECT_TYPE, REVALIDATE, Content
from server.library import ServedStream
from server.operate.prometheus import Metrics

K = TypeVar("K", bound=Hashable)
V = TypeVar("V")


class ByteCache(Generic[K, V]):
    """Holds values of at most `capacity_bytes` in all. What was dropped here lives on where it is
    in use."""

    def __init__(self, capacity_bytes: int) -> None:
        self._capacity_bytes = capacity_bytes
        self._held: OrderedDict[K, tuple[V, int]] = OrderedDict()  # with its bytes
        self.size_bytes = 0

    def get(self, key: K) -> V | None:
        found = self._held.get(key)
        if found is None:
            return None
        self._held.move_to_end(key)
        return found[0]

    def keep(self, key: K, value: V, num_bytes: int) -> None:
        """Holds `value` in place of what had this key, unless it is too large by itself."""
        _, before_bytes = self._held.pop(key, (None, 0))
        self.size_bytes -= before_bytes
        if num_bytes > self._capacity_bytes:
            return
        self._held[key] = value, num_bytes
        self.size_bytes += num_bytes
        while self.size_bytes > self._capacity_bytes:
            _, (_, dropped_bytes) = self._held.popitem(last=False)
            self.size_bytes -= dropped_bytes


ObjectKey = tuple[int, int, Part]
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
        self._objects = ByteCache[ObjectKey, CachedObject](capacity_bytes)
        self._loading: dict[ObjectKey, asyncio.Task[CachedObject]] = {}

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

    async def _load(self, key: ObjectKey, stream: ServedStream) -> CachedObject:
        try:
            loaded = CachedObject(await asyncio.to_thread(stream.read_object, *key[1:]))
        finally:
            del self._loading[key]
        self._objects.keep(key, loaded, len(loaded.checked.data))
        self._metrics.cache_bytes.set(self.size_bytes)
        return loaded


RecordKey = tuple[int, int, int, int, str | None]
"""Generation of the stream, birth, first and end layer, coding."""


@dataclass(frozen=True, slots=True)
class CodedRecord:
    """A record as it goes out, and what is in it."""

    data: bytes
    parts: tuple[Part, ...]
    packet_bytes: tuple[int, ...]
    """Bytes of the packets of each part."""
    body_bytes: int
    """Bytes of it as its reader gets them, without the coding of the response."""


class RecordCache:
    """Makes records, and keeps those that are asked for."""

    def __init__(self, objects: ObjectCache, capacity_bytes: int) -> None:
        self._objects = objects
        self._records = ByteCache[RecordKey, CodedRecord](capacity_bytes)

    async def slices(
        self, stream: ServedStream, send: SendSlices, plain: PlainRecordEncoder | None
    ) -> tuple[list[CodedRecord], CodecError | OSError | None]:
        """A record for each slice of `send`, with its mask where it has layer 0; or for those
        before a file that is bad, and what is wrong with it.

        plain: what codes the response; None for packets as they are.
        """
        first, end, generation = send.first_layer, send.end_layer, stream.generation
        coding = plain.coding if plain is not None else None
        coded = []
        try:
            for birth in send.births:
                key = generation, birth, first, end, coding
                coded.append(self._records.get(key) or await self._slice(key, stream, plain))
        except (CodecError, OSError) as error:
            return coded, error
        return coded, None

    async def _slice(
        self, key: RecordKey, stream: ServedStream, plain: PlainRecordEncoder | None
    ) -> CodedRecord:
        _, birth, first_layer, end_layer, _ = key
        segment = stream.view.manifest.segment_of(birth)
        layers: list[Part] = [*range(first_layer, end_layer)]
        parts = layers if first_layer else [*layers, MASKS]
        packets = [
            (await self._objects.load(stream, segment, part)).packet(birth) for part in parts
        ]
        mask = packets[-1] if len(parts) > len(layers) else None
        record = SliceRecord(birth, tuple(packets[: len(layers)]), mask, first_layer)
        coded = _coded(record, plain, parts, packets)
        # What continues the records before it is worth nothing to others.
        if plain is None or not plain.continues:
            self._records.keep(key, coded, len(coded.data))
        return coded

    async def snapshots(
        self,
        stream: ServedStream,
        frame: int,
        first_layer: int,
        most_bytes: int,
        end_layer: int,
        plain: PlainRecordEncoder | None,
    ) -> CodedRecord:
        """The snapshots at `frame` of layers from `first_layer` on: as many as have not much more
        than `most_bytes`, up to `end_layer`."""
        segment = stream.view.manifest.segment_of(frame)
        parts, packets = list[Part](), list[bytes]()
        for layer in range(first_layer, end_layer):
            part = snapshot_part(layer)
            parts.append(part)
            packets.append((await self._objects.load(stream, segment, part)).packet(frame))
            if sum(map(len, packets)) >= most_bytes:
                break
        record = SnapshotRecord(frame, first_layer, tuple(packets))
        return _coded(record, plain, parts, packets)


def _coded(
    record: SliceRecord | SnapshotRecord,
    plain: PlainRecordEncoder | None,
    parts: list[Part],
    packets: list[bytes],
) -> CodedRecord:
    if plain is None:
        data = encode_record(record)
        body_bytes = len(data)
    else:
        data, body_bytes = plain.encode_sized(record)
    return CodedRecord(data, tuple(parts), tuple(map(len, packets)), body_bytes)


SoundKey = tuple[int, int, str]
"""Generation of the stream, segment and name of the object."""


class SoundCache:
    """The objects of sound of all streams. Two requests at the same moment may both read what is
    not there yet."""

    def __init__(self, capacity_bytes: int) -> None:
        self._objects = ByteCache[SoundKey, tuple[Stamp, Content]](capacity_bytes)

    @property
    def size_bytes(self) -> int:
        return self._objects.size_bytes

    async def content(self, stream: ServedStream, segment: int, name: str) -> Content:
        """The object that `stream.has_sound`, as an answer. Raises a CodecError for a bad file."""
        key = (stream.generation, segment, name)
        # Before the content: what is replaced between the two is read again at the next request.
        stamp = await asyncio.to_thread(stream.sound_stamp, segment, name)
        found = self._objects.get(key)
        if found is not None and found[0] == stamp:
            return found[1]
        content = await asyncio.to_thread(_load, stream, segment, name)
        if stamp is not None:
            self._objects.keep(key, (stamp, content), len(content.data))
        return content


def _load(stream: ServedStream, segment: int, name: str) -> Content:
    """Blocks."""
    data = stream.read_sound(segment, name)
    sha256 = hashlib.sha256(data).hexdigest()
    return Content(data, sha256, OBJECT_TYPE, REVALIDATE)
