"""The records of a /play response: u32 little-endian length, then a msgpack map.

Sans-IO: `RecordParser` takes bytes in any pieces and gives records; it holds at most one record.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Any

import msgpack

from codec.errors import CorruptError, InvalidError
from codec.slots.slotlayout import MAX_LAYERS

LENGTH = struct.Struct("<I")

CONTENT_TYPE = "application/x-swings-play"
"""Content type of a response that is made of these records."""

PACKETS_KEY = "packets"
"""The key of the packets on the wire."""

MAX_MESSAGE_CHARS = 500
"""Characters of an error's message that are sent and taken."""

MAX_KEYS = 8
"""Entries of a record's map; four are in use."""

MAX_ITEMS = MAX_LAYERS
"""Entries of an array in a record: its packets, one a layer."""

MAX_TEXT_BYTES = 1 << 16
"""Longest text in a record, in bytes: one odd character makes Python hold it fourfold."""

MAX_RECORD_BYTES = 64 << 20
"""Longest record accepted, in bytes: a slice of a million raw Gaussians."""


@dataclass(frozen=True, slots=True)
class StartRecord:
    """The first record: what follows shows from `from_frame` on."""

    from_frame: int
    num_frames: int  # known when the response began; may grow while live
    manifest: bytes  # manifest.json


@dataclass(frozen=True, slots=True)
class SliceRecord:
    """Packets of one slice: its layers may come together, apart, late, or never."""

    birth: int
    packets: tuple[bytes, ...]
    """Packets of the layers first_layer, first_layer + 1, ..., at least one unless it has a skip
    map. A packet has no bytes where nothing changes."""
    skip_map: bytes | None = None
    """The packet of its skip map, which comes with layer 0 and no other."""
    first_layer: int = 0


@dataclass(frozen=True, slots=True)
class KeyframeRecord:
    """Layers as they are after the slice of `frame`, the first of a segment."""

    frame: int
    first_layer: int
    packets: tuple[bytes, ...]
    """The keyframes of the layers first_layer, first_layer + 1, ..., at least one."""


@dataclass(frozen=True, slots=True)
class EndRecord:
    """The last record of a response that was sent to its end."""

    num_frames: int


@dataclass(frozen=True, slots=True)
class ErrorRecord:
    """The last record of a response that the server had to break off."""

    message: str


Record = StartRecord | SliceRecord | KeyframeRecord | EndRecord | ErrorRecord


def encode_record(record: Record) -> bytes:
    """The record's bytes, length first. Raises InvalidError if no reader would take them."""
    _check(record)
    match record:
        case StartRecord():
            value: dict[str, Any] = {
                "kind": "start",
                "from": record.from_frame,
                "num_frames": record.num_frames,
                "manifest": record.manifest,
            }
        case SliceRecord():
            value = {"kind": "slice", "birth": record.birth, PACKETS_KEY: list(record.packets)}
            if record.skip_map is not None:
                value["skip_map"] = record.skip_map
            if record.first_layer:
                value["first"] = record.first_layer
        case KeyframeRecord():
            value = {
                "kind": "keyframe",
                "frame": record.frame,
                "first": record.first_layer,
                PACKETS_KEY: list(record.packets),
            }
        case EndRecord():
            value = {"kind": "end", "num_frames": record.num_frames}
        case ErrorRecord():
            # A path in a message may hold bytes that are not UTF-8.
            message = record.message[:MAX_MESSAGE_CHARS].encode(errors="replace").decode()
            value = {"kind": "error", "message": message}
    body: bytes = msgpack.packb(value, use_bin_type=True)
    if len(body) > MAX_RECORD_BYTES:
        raise InvalidError(f"play: a record of {len(body)} bytes, at most {MAX_RECORD_BYTES}")
    return LENGTH.pack(len(body)) + body


def _check(record: Record) -> None:
    """Raises InvalidError if a number or the packets of `record` break a rule."""
    match record:
        case StartRecord():
            sound = 0 <= record.from_frame < 1 << 31 and 0 <= record.num_frames < 1 << 31
        case SliceRecord():
            sound = record.first_layer >= 0 and (record.skip_map is None) == (
                record.first_layer > 0
            )
            least = int(record.first_layer > 0)
            sound &= least <= len(record.packets) <= MAX_LAYERS - record.first_layer
            sound &= -(1 << 31) <= record.birth < 1 << 31
        case KeyframeRecord():
            sound = 0 <= record.frame < 1 << 31 and record.first_layer >= 0
            sound &= 1 <= len(record.packets) <= MAX_LAYERS - record.first_layer
        case EndRecord():
            sound = 0 <= record.num_frames < 1 << 31
        case ErrorRecord():
            sound = True
    if not sound:
        raise InvalidError(f"play: a {type(record).__name__} with a number that no reader accepts")


def _field(value: dict[str, Any], key: str, kind: type) -> Any:
    found = value.get(key)
    if type(found) is not kind:
        raise CorruptError(f"play: {value.get('kind')!r} record without a valid {key!r}")
    return found


def _count(value: dict[str, Any], key: str) -> int:
    number: int = _field(value, key, int)
    if not 0 <= number < 1 << 31:
        raise CorruptError(f"play: {key!r} is {number}")
    return number


def _packets(value: dict[str, Any], least: int) -> tuple[bytes, ...]:
    packets = _field(value, PACKETS_KEY, list)
    if not least <= len(packets) <= MAX_LAYERS or any(type(p) is not bytes for p in packets):
        raise CorruptError(f"play: a {value['kind']!r} record without packets of its layers")
    return tuple(packets)


def _check_layers(first_layer: int, packets: tuple[bytes, ...]) -> None:
    if first_layer + len(packets) > MAX_LAYERS:
        raise CorruptError(
            f"play: {len(packets)} packets from layer {first_layer} on, of {MAX_LAYERS} layers at "
            "most"
        )


def _flat_list(items: list[Any]) -> list[Any]:
    """Refuses lists in lists as soon as one is built: a tree of them grows 64-fold in memory."""
    if any(type(item) is not bytes for item in items):
        raise ValueError("a list holds something else than bin")
    return items


def _flat_map(value: dict[Any, Any]) -> dict[Any, Any]:
    if any(type(item) is dict for item in value.values()):
        raise ValueError("a map in a map")
    return value


def decode_record(body: bytes | memoryview) -> Record:
    """The record in `body`, which comes without its length."""
    try:
        value = msgpack.unpackb(
            body,
            raw=False,
            strict_map_key=True,
            list_hook=_flat_list,
            object_hook=_flat_map,
            max_str_len=MAX_TEXT_BYTES,
            max_array_len=MAX_ITEMS,
            max_map_len=MAX_KEYS,
            max_ext_len=0,
        )
    except (ValueError, TypeError, RecursionError, msgpack.UnpackException) as error:
        raise CorruptError(f"play: a record is not msgpack ({type(error).__name__})") from error
    if type(value) is not dict:
        raise CorruptError("play: a record is not a map")
    match value.get("kind"):
        case "start":
            return StartRecord(
                _count(value, "from"), _count(value, "num_frames"), _field(value, "manifest", bytes)
            )
        case "slice":
            birth: int = _field(value, "birth", int)
            if not -(1 << 31) <= birth < 1 << 31:
                raise CorruptError(f"play: the birth {birth} of a slice does not fit 32 bits")
            first_layer = _count(value, "first") if "first" in value else 0
            packets = _packets(value, int(first_layer > 0))
            _check_layers(first_layer, packets)
            skip_map = None if first_layer else _field(value, "skip_map", bytes)
            return SliceRecord(birth, packets, skip_map, first_layer)
        case "keyframe":
            packets, first_layer = _packets(value, 1), _count(value, "first")
            _check_layers(first_layer, packets)
            return KeyframeRecord(_count(value, "frame"), first_layer, packets)
        case "end":
            return EndRecord(_count(value, "num_frames"))
        case "error":
            return ErrorRecord(_field(value, "message", str)[:MAX_MESSAGE_CHARS])
        case kind:
            shown = f"{kind[:40]!r}" if type(kind) is str else type(kind).__name__
            raise CorruptError(f"play: a record of kind {shown}")


class RecordParser:
    """Turns the bytes of a /play response, in any pieces, into records."""

    def __init__(self) -> None:
        self._pending = bytearray()
        self.limit_bytes = MAX_RECORD_BYTES
        """Longest record that is taken; a reader that knows the stream may lower it."""

    @property
    def pending_bytes(self) -> int:
        """Bytes held of a record that is not whole yet; 0 at the end of a whole response."""
        return len(self._pending)

    def feed(self, data: bytes | memoryview) -> list[Record]:
        """The records that `data` completes, in order. After a CorruptError feed nothing more."""
        self._pending += data
        records: list[Record] = []
        start = 0
        while len(self._pending) - start >= LENGTH.size:
            (length,) = LENGTH.unpack_from(self._pending, start)
            if length > self.limit_bytes:
                raise CorruptError(f"play: a record of {length} bytes, at most {self.limit_bytes}")
            end = start + LENGTH.size + length
            if len(self._pending) < end:
                break
            # A view: a copy of a large record would double what it costs.
            with memoryview(self._pending) as view, view[start + LENGTH.size : end] as body:
                records.append(decode_record(body))
            start = end
        del self._pending[:start]
        return records
