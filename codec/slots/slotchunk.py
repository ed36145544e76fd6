"""The head of a chunk (codec/FORMAT.md, section 9)."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import IntEnum

from codec.errors import CorruptError, InvalidError, UnsupportedError

from .slotlayout import HEADER_BYTES

SLOT_MAGIC = b"SWG1"

FLAG_SLOT_OFFSETS = 1
"""Set when start offsets are stored; clear when all are zero."""

# magic, kind, layer, flags, zero, birth
SLOT_HEADER = struct.Struct("<4sBBBBi")
assert SLOT_HEADER.size == HEADER_BYTES

BIRTH = struct.Struct("<i")
KIND_AT, LAYER_AT, FLAGS_AT, ZERO_AT, BIRTH_AT = 4, 5, 6, 7, 8
"""Where in a chunk these fields lie."""


def with_birth(data: bytes | memoryview, birth: int) -> bytes:
    """The chunk in `data` as one of `birth`."""
    return b"".join((data[:BIRTH_AT], BIRTH.pack(birth), data[BIRTH_AT + BIRTH.size :]))


class Kind(IntEnum):
    """The kinds of chunks of slots."""

    MASK = 0
    CHANGE = 1
    SNAPSHOT = 2


@dataclass(frozen=True, slots=True)
class SlotHeader:
    """The first HEADER_BYTES of a chunk, checked."""

    kind: Kind
    layer: int
    birth: int
    """Birth of the slice; in a snapshot the first frame of its segment."""
    has_start_offsets: bool = False

    def pack(self) -> bytes:
        if not -(1 << 31) <= self.birth < 1 << 31:
            raise InvalidError(f"{self.name}: birth {self.birth} does not fit 32 bits")
        flags = FLAG_SLOT_OFFSETS if self.has_start_offsets else 0
        return SLOT_HEADER.pack(SLOT_MAGIC, self.kind, self.layer, flags, 0, self.birth)

    @property
    def name(self) -> str:
        """The chunk's kind, in messages."""
        return self.kind.name.lower()

    @staticmethod
    def read(data: bytes | memoryview, kind: Kind) -> SlotHeader:
        """The header at the start of `data`, which should be that of a chunk of `kind`."""
        name = kind.name.lower()
        if len(data) < HEADER_BYTES:
            raise CorruptError(
                f"{name}: {len(data)} bytes are too few for a header of {HEADER_BYTES}", len(data)
            )
        magic, found, layer, flags, zero, birth = SLOT_HEADER.unpack_from(data)
        if magic != SLOT_MAGIC:
            raise CorruptError(f"{name}: starts with {bytes(magic)!r}, not {SLOT_MAGIC!r}", 0)
        if found not in set(Kind):
            known = ", ".join(f"{k.value} ({k.name.lower()})" for k in Kind)
            raise UnsupportedError(f"{name}: kind {found}; this program reads {known}", KIND_AT)
        if found != kind:
            other = Kind(found).name.lower()
            raise CorruptError(f"{name}: a {other} where a {name} belongs", KIND_AT)
        if flags & ~FLAG_SLOT_OFFSETS or (flags and kind is Kind.MASK) or zero:
            at = FLAGS_AT if flags & ~FLAG_SLOT_OFFSETS or kind is Kind.MASK else ZERO_AT
            raise UnsupportedError(f"{name}: a reserved bit is set", at)
        if kind is Kind.MASK and layer:
            raise CorruptError(f"mask: layer {layer} where 0 belongs", LAYER_AT)
        return SlotHeader(kind, layer, birth, bool(flags))

    def expect(self, birth: int, layer: int) -> None:
        """Raises CorruptError unless this is the header of `birth` and `layer`."""
        if self.birth != birth:
            raise CorruptError(
                f"{self.name}: birth {self.birth} where birth {birth} belongs", BIRTH_AT
            )
        if self.layer != layer:
            raise CorruptError(
                f"{self.name}: layer {self.layer} where layer {layer} belongs", LAYER_AT
            )
