"""The records of plays, encoded once for all clients of a stream; bounded in bytes."""

from __future__ import annotations

from dataclasses import dataclass

from codec.errors import CodecError
from codec.stream.manifest import MASKS, Part, snapshot_part
from codec.stream.plainrecord import PlainRecordEncoder
from codec.stream.playrecord import SliceRecord, SnapshotRecord, encode_record
from server.abr.decisioncontext import SendSlices
from server.library import ServedStream

from .bytecache import ByteCache
from .objectcache import ObjectCache

Key = tuple[int, int, int, int, str | None]
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
        self._records = ByteCache[Key, CodedRecord](capacity_bytes)

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
        self, key: Key, stream: ServedStream, plain: PlainRecordEncoder | None
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
