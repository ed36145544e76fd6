"""The sound of a stream: its sources in the manifest, and the objects that hold their Opus packets.

Rule: pure, and an object is whole in itself: its size, its checksum and enough packets before the
first sample of its segment that a decoder which begins with it is right from that sample on.
"""

from __future__ import annotations

import itertools
import math
import re
import struct
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from codec.errors import CorruptError, InvalidError

from .manifestjson import number, typed

SAMPLE_RATE = 48000
"""Samples in a second, of every source."""

PREROLL = 3840
"""Samples before the first of a segment from which its packets run: the 80 ms after which a decoder
is right, by RFC 7845."""

DEFAULT_BITRATE_BPS = 96000
"""Bits of Opus a second of a source, unless another rate is chosen."""

MAX_SOURCES = 16
MAX_KEYS = 256
MAX_PACKETS = 1 << 16
MAX_SOUND_BYTES = 1 << 24
"""Largest object of sound."""

MAX_POSITION = 1 << 52
MAX_PACKET_SAMPLES = 5760

SOUND_PREFIX = "audio-"
SOUND_NAME = "[a-z0-9]{1,32}"
"""Regular expression of a source's name."""

MAGIC = b"SWA1"
# magic; size; CRC-32 of what follows it; channels, 0, pre-skip; packets; first position, length
HEAD = struct.Struct("<4sIIBBHIQQ")
assert HEAD.size == 36
_CHECKED_FROM = 12

Key = tuple[float, float, float, float]


@dataclass(frozen=True, slots=True)
class SoundSource:
    """One source of sound of a stream. Raises InvalidError when a value breaks a rule."""

    name: str
    """1 to 32 small letters and digits."""
    channels: int
    """1 or 2."""
    keys: tuple[Key, ...] = ()
    """Where it is: time in seconds and x, y, z in metres, at increasing times. It moves straight
    from key to key and rests before the first and after the last; without keys it is nowhere, and
    heard as it is. One with keys has 1 channel."""

    def __post_init__(self) -> None:
        if re.fullmatch(SOUND_NAME, self.name) is None:
            raise InvalidError(
                f"manifest: a source of sound is called {self.name[:40]!a}; use 1 to 32 small "
                "letters and digits"
            )
        if self.channels not in (1, 2):
            raise InvalidError(
                f"manifest: sound {self.name} has {self.channels} channels, not 1..2"
            )
        if len(self.keys) > MAX_KEYS or (self.keys and self.channels != 1):
            raise InvalidError(
                f"manifest: sound {self.name} has {len(self.keys)} places and {self.channels} "
                f"channels; at most {MAX_KEYS}, and 1 channel with any"
            )
        if not all(len(key) == 4 and all(map(math.isfinite, key)) for key in self.keys):
            raise InvalidError(f"manifest: a place of sound {self.name} is not four numbers")
        times = [key[0] for key in self.keys]
        if any(a >= b for a, b in itertools.pairwise(times)):
            raise InvalidError(
                f"manifest: the places of sound {self.name} are not in order of time"
            )

    @property
    def part(self) -> str:
        """The name of its objects, in place of a layer's number."""
        return SOUND_PREFIX + self.name

    def position_m(self, time_s: float) -> tuple[float, float, float] | None:
        """Where it is at `time_s`; None without keys."""
        if not self.keys:
            return None
        before = [key for key in self.keys if key[0] <= time_s]
        after = [key for key in self.keys if key[0] > time_s]
        if not before or not after:
            _, x, y, z = before[-1] if before else after[0]
            return x, y, z
        a, b = before[-1], after[0]
        share = (time_s - a[0]) / (b[0] - a[0])
        x, y, z = (p + (q - p) * share for p, q in zip(a[1:], b[1:], strict=True))
        return x, y, z

    def to_json(self) -> dict[str, Any]:
        keys = [list(key) for key in self.keys]
        return {"name": self.name, "channels": self.channels, "keys": keys}

    @staticmethod
    def from_json(value: Any) -> SoundSource:
        """The source that `value` describes. Raises CorruptError or InvalidError."""
        if type(value) is not dict:
            raise CorruptError("manifest: a source of sound is not an object")
        keys = keys_of(typed(value, "keys", list))
        return SoundSource(typed(value, "name", str), typed(value, "channels", int), keys)


def keys_of(value: Sequence[Any]) -> tuple[Key, ...]:
    """The keys that the JSON list `value` holds, one more than is allowed at most. Raises
    CorruptError."""
    keys: list[Key] = []
    for key in value[: MAX_KEYS + 1]:
        if type(key) is not list or len(key) != 4:
            raise CorruptError("manifest: a place of a sound is not four numbers")
        time_s, x, y, z = (number(item, "keys") for item in key)
        keys.append((time_s, x, y, z))
    return tuple(keys)


def check_sources(sources: Sequence[SoundSource]) -> None:
    """Raises InvalidError for too many sources, or two of one name."""
    if len(sources) > MAX_SOURCES:
        raise InvalidError(f"manifest: {len(sources)} sources of sound, at most {MAX_SOURCES}")
    if len({source.name for source in sources}) != len(sources):
        raise InvalidError("manifest: two sources of sound have the same name")


def sources_of(value: Mapping[str, Any]) -> tuple[SoundSource, ...]:
    """The sources in the JSON of a manifest. Raises CorruptError or InvalidError."""
    sources = typed({"sound": [], **value}, "sound", list)
    if len(sources) > MAX_SOURCES:
        raise CorruptError(f"manifest: {len(sources)} sources of sound, at most {MAX_SOURCES}")
    return tuple(map(SoundSource.from_json, sources))


def first_sample(frame: int, fps: float) -> int:
    """The first sample that is heard with `frame`."""
    return math.floor(frame * SAMPLE_RATE / fps)


def packet_samples(packet: bytes) -> int:
    """Samples that an Opus packet decodes to, by its first bytes. Raises CorruptError."""
    if not packet:
        raise CorruptError("sound: an empty packet", 0)
    config, code = packet[0] >> 3, packet[0] & 3
    if config < 12:
        each = (480, 960, 1920, 2880)[config & 3]
    elif config < 16:
        each = (480, 960)[config & 1]
    else:
        each = (120, 240, 480, 960)[config & 3]
    count = (1, 2, 2, packet[1] & 63 if len(packet) > 1 else 0)[code]
    if not 0 < each * count <= MAX_PACKET_SAMPLES:
        raise CorruptError(f"sound: a packet of {each * count} samples", 0)
    return each * count


@dataclass(frozen=True, slots=True)
class SoundObject:
    """The packets of one source in one segment. `parse` and `pack` check the rules."""

    channels: int
    pre_skip: int
    """Sample 0 of the stream is at this position of what the packets decode to."""
    num_samples: int
    """Length of the whole source, from sample 0 on; silence follows."""
    first: int
    """Position where the first packet begins."""
    packets: tuple[bytes, ...]

    @property
    def end(self) -> int:
        """Position where the last packet ends."""
        return self.first + sum(map(packet_samples, self.packets))

    def check_covers(self, begin: int, stop: int) -> None:
        """Raises CorruptError unless the packets hold the samples from `begin` to `stop`, and
        PREROLL before them, as far as the source goes; or if they go far beyond that."""
        stop = min(stop, self.num_samples)
        if self.packets and self.end > stop + self.pre_skip + 2 * MAX_PACKET_SAMPLES:
            raise CorruptError(f"sound: packets up to {self.end}, but it ends at sample {stop}", 20)
        if begin >= stop:
            return
        if self.first > max(0, begin + self.pre_skip - PREROLL) or self.end < stop + self.pre_skip:
            raise CorruptError(
                f"sound: packets from {self.first} to {self.end} do not hold samples {begin} to "
                f"{stop} with what a decoder needs before them",
                20,
            )

    def pack(self) -> bytes:
        """The bytes of the object. Raises InvalidError if it is too large."""
        sizes = [len(packet) for packet in self.packets]
        total = HEAD.size + 2 * len(sizes) + sum(sizes)
        if len(sizes) > MAX_PACKETS or total > MAX_SOUND_BYTES or max(sizes, default=0) > 0xFFFF:
            raise InvalidError(
                f"a segment has {total} bytes of sound in {len(sizes)} packets, at most "
                f"{MAX_SOUND_BYTES} in {MAX_PACKETS}; use a lower bit rate or shorter segments"
            )
        head = HEAD.pack(
            MAGIC,
            total,
            0,
            self.channels,
            0,
            self.pre_skip,
            len(sizes),
            self.first,
            self.num_samples,
        )
        data = head + struct.pack(f"<{len(sizes)}H", *sizes) + b"".join(self.packets)
        crc32 = zlib.crc32(data[_CHECKED_FROM:])
        return data[:8] + struct.pack("<I", crc32) + data[_CHECKED_FROM:]

    @staticmethod
    def parse(data: bytes) -> SoundObject:
        """The object in `data`. Raises CorruptError."""
        if len(data) < HEAD.size or data[:4] != MAGIC:
            raise CorruptError("sound: this is not an object of sound", 0)
        fields = HEAD.unpack_from(data)
        _, size, crc32, channels, reserved, pre_skip, count, first, num_samples = fields
        if size != len(data) or size > MAX_SOUND_BYTES:
            raise CorruptError(f"sound: {len(data)} bytes, but it says {size}", 4)
        if zlib.crc32(data[_CHECKED_FROM:]) != crc32:
            raise CorruptError("sound: the checksum is wrong", 8)
        if channels not in (1, 2) or reserved:
            raise CorruptError(f"sound: {channels} channels, reserved {reserved}", 12)
        if max(first, num_samples) > MAX_POSITION:
            raise CorruptError("sound: a position is out of range", 20)
        begin = HEAD.size + 2 * count
        if count > MAX_PACKETS or begin > len(data):
            raise CorruptError(f"sound: {count} packets", 16)
        sizes = struct.unpack_from(f"<{count}H", data, HEAD.size)
        if begin + sum(sizes) != len(data):
            raise CorruptError("sound: the sizes of the packets do not add up", HEAD.size)
        packets = []
        for packet_bytes in sizes:
            packet = data[begin : begin + packet_bytes]
            try:
                packet_samples(packet)
            except CorruptError as error:
                raise error.moved(begin) from error
            packets.append(packet)
            begin += packet_bytes
        return SoundObject(channels, pre_skip, num_samples, first, tuple(packets))


def checked_object(data: bytes, source: SoundSource, begin: int, stop: int) -> SoundObject:
    """The object in `data`, if it is one of `source` and holds the samples from `begin` to `stop`.
    Raises CorruptError."""
    found = SoundObject.parse(data)
    if found.channels != source.channels:
        raise CorruptError(f"sound: {found.channels} channels, not {source.channels}", 12)
    found.check_covers(begin, stop)
    return found


def segment_sound(whole: SoundObject, begin: int, stop: int) -> SoundObject:
    """The packets of a segment with the samples `begin` to `stop`, chosen from the entire source in
    `whole`."""
    least, most = begin + whole.pre_skip - PREROLL, stop + whole.pre_skip
    at, first, chosen = whole.first, None, []
    for packet in whole.packets:
        end = at + packet_samples(packet)
        if end > least and at < most:
            first = at if first is None else first
            chosen.append(packet)
        at = end
    first = whole.end if first is None else first
    return SoundObject(whole.channels, whole.pre_skip, whole.num_samples, first, tuple(chosen))
