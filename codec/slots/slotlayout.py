"""The slots of a stream: how many, on which lattice, and how large their chunks can be. The head of
a chunk (codec/FORMAT.md, section 9), and the update that a trainer hands over for a slice: what
becomes of each slot of a lane.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import IntEnum
from itertools import accumulate

import numpy as np

from codec.arrays import Bytes, Flags
from codec.errors import CorruptError, InvalidError, UnsupportedError
from codec.lattice.lattice import (
    POSITION_LIMIT,
    Lattice,
    States,
    bytes_per_gaussian,
    num_attributes,
)
from codec.slice import MAX_SWIN_SIZE
from codec.splats import MAX_SH_DEGREE, Splats

from .rangecoder import CODE_BYTES

MAX_SLOTS = 1 << 20
"""Slots in a lane, all layers together."""

MAX_SLOTS_OF_LANES = 1 << 24
"""Slots in all lanes together."""

MAX_SEGMENT_SLOTS = 1 << 28
"""Slots of a lane times frames in a segment: bounds what the skip maps of a segment inflate to."""

MAX_SKIP_MAP_BYTES_PER_SLOT = 4
"""Three bits at most, each of which costs 10.5 at most: a probability stays above 3 in 4096."""

MAX_LAYERS = 16
"""Layers of a slice: what a manifest, an index record and a chunk may name."""

MAX_SEGMENT_FRAMES = 4096

HEADER_BYTES = 12
"""In front of every chunk."""

COUNTS_BYTES = 20
"""In front of every change, and behind the flags of a keyframe."""

MAX_SLOT_CHUNK_BYTES = 64 + 248_512_560
"""The largest chunk, whatever the layout."""


@dataclass(frozen=True, slots=True)
class SlotLayout:
    """Layout by which skip maps, changes and keyframes are read. Raises InvalidError for a layout
    that the format does not allow."""

    swin_size: int
    """Lanes, and frames that a lease lasts."""
    slots: tuple[int, ...]
    """Slots of a lane in each layer."""
    sh_degree: int
    lattices: tuple[Lattice, ...]
    """The lattice of each layer."""
    segment_frames: int
    """Frames in a segment: skip maps and keyframes begin anew with each."""

    def __post_init__(self) -> None:
        if not 1 <= self.swin_size <= MAX_SWIN_SIZE:
            raise InvalidError(f"slots: swin_size {self.swin_size} is not in 1..{MAX_SWIN_SIZE}")
        if not 1 <= len(self.slots) <= MAX_LAYERS:
            raise InvalidError(f"slots: {len(self.slots)} layers, expected 1 to {MAX_LAYERS}")
        if min(self.slots) < 1 or sum(self.slots) > MAX_SLOTS:
            raise InvalidError(
                f"slots: {self.slots[:16]} are not at least 1 each and {MAX_SLOTS} together at most"
            )
        if self.swin_size * self.num_slots > MAX_SLOTS_OF_LANES:
            raise InvalidError(
                f"slots: {self.num_slots} in each of {self.swin_size} lanes are more than "
                f"{MAX_SLOTS_OF_LANES}"
            )
        if not 0 <= self.sh_degree <= MAX_SH_DEGREE:
            raise InvalidError(f"slots: SH degree {self.sh_degree} is not in 0..{MAX_SH_DEGREE}")
        if len(self.lattices) != len(self.slots):
            raise InvalidError(
                f"slots: {len(self.lattices)} lattices for {len(self.slots)} layers; give one each"
            )
        if not 1 <= self.segment_frames <= MAX_SEGMENT_FRAMES:
            raise InvalidError(
                f"slots: segment_frames {self.segment_frames} is not in 1..{MAX_SEGMENT_FRAMES}"
            )
        if self.segment_frames * self.num_slots > MAX_SEGMENT_SLOTS:
            raise InvalidError(
                f"slots: {self.num_slots} slots in segments of {self.segment_frames} frames, their "
                f"product is at most {MAX_SEGMENT_SLOTS}; use shorter segments"
            )

    @property
    def num_layers(self) -> int:
        return len(self.slots)

    @property
    def num_slots(self) -> int:
        """Slots of a lane, all layers together."""
        return sum(self.slots)

    @property
    def num_planes(self) -> int:
        """Byte planes of the Gaussians in a change: x, y, z and the attributes."""
        return 3 + num_attributes(self.sh_degree)

    @property
    def row_edges(self) -> tuple[int, ...]:
        """(L + 1,) where the slots of each layer begin in a lane, and where the last ends."""
        return (0, *accumulate(self.slots))

    def lane(self, birth: int) -> int:
        """The lane of the slice born at `birth`."""
        return birth % self.swin_size

    def segment_start(self, birth: int) -> int:
        """First frame of the segment that holds the slice born at `birth`, 0 or later."""
        return birth // self.segment_frames * self.segment_frames

    @property
    def max_skip_map_bytes(self) -> int:
        """Bytes of the longest skip map, before the entropy coder."""
        return HEADER_BYTES + CODE_BYTES + MAX_SKIP_MAP_BYTES_PER_SLOT * self.num_slots

    def max_change_bytes(self, layer: int) -> int:
        """Bytes of the longest change of `layer`: all new, all escaped."""
        most = HEADER_BYTES + COUNTS_BYTES + self.slots[layer] * self._max_slot_bytes
        return min(most, MAX_SLOT_CHUNK_BYTES)

    def max_keyframe_bytes(self, layer: int) -> int:
        """Bytes of the longest keyframe of `layer`."""
        count = self.swin_size * self.slots[layer]
        most = HEADER_BYTES + self.flags_bytes(layer) + COUNTS_BYTES + count * self._max_slot_bytes
        return min(most, MAX_SLOT_CHUNK_BYTES)

    def flags_bytes(self, layer: int) -> int:
        """Bytes of the flags in a keyframe of `layer`: a bit for each slot of each lane."""
        return (self.swin_size * self.slots[layer] + 7) // 8

    @property
    def _max_slot_bytes(self) -> int:
        """Largest size of a new Gaussian: its planes, 24 low bits for each axis, the number and the
        floats of an escape, the start offset. A predicted one takes less."""
        return self.num_planes + 9 + 4 + bytes_per_gaussian(self.sh_degree) + 1


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

    SKIP_MAP = 0
    CHANGE = 1
    KEYFRAME = 2

    @property
    def words(self) -> str:
        """Its name in messages."""
        return self.name.lower().replace("_", " ")


@dataclass(frozen=True, slots=True)
class SlotHeader:
    """The first HEADER_BYTES of a chunk, checked."""

    kind: Kind
    layer: int
    birth: int
    """Birth of the slice; in a keyframe the first frame of its segment."""
    has_start_offsets: bool = False

    def pack(self) -> bytes:
        if not -(1 << 31) <= self.birth < 1 << 31:
            raise InvalidError(f"{self.name}: birth {self.birth} does not fit 32 bits")
        flags = FLAG_SLOT_OFFSETS if self.has_start_offsets else 0
        return SLOT_HEADER.pack(SLOT_MAGIC, self.kind, self.layer, flags, 0, self.birth)

    @property
    def name(self) -> str:
        """The chunk's kind, in messages."""
        return self.kind.words

    @staticmethod
    def read(data: bytes | memoryview, kind: Kind) -> SlotHeader:
        """The header at the start of `data`, which should be that of a chunk of `kind`."""
        name = kind.words
        if len(data) < HEADER_BYTES:
            raise CorruptError(
                f"{name}: {len(data)} bytes are too few for a header of {HEADER_BYTES}", len(data)
            )
        magic, found, layer, flags, zero, birth = SLOT_HEADER.unpack_from(data)
        if magic != SLOT_MAGIC:
            raise CorruptError(f"{name}: starts with {bytes(magic)!r}, not {SLOT_MAGIC!r}", 0)
        if found not in set(Kind):
            known = ", ".join(f"{k.value} ({k.words})" for k in Kind)
            raise UnsupportedError(f"{name}: kind {found}; this program reads {known}", KIND_AT)
        if found != kind:
            other = Kind(found).words
            raise CorruptError(f"{name}: a {other} where a {name} belongs", KIND_AT)
        if flags & ~FLAG_SLOT_OFFSETS or (flags and kind is Kind.SKIP_MAP) or zero:
            at = FLAGS_AT if flags & ~FLAG_SLOT_OFFSETS or kind is Kind.SKIP_MAP else ZERO_AT
            raise UnsupportedError(f"{name}: a reserved bit is set", at)
        if kind is Kind.SKIP_MAP and layer:
            raise CorruptError(f"skip map: layer {layer} where 0 belongs", LAYER_AT)
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


KEPT, ENDED, PREDICTED, NEW = range(4)
"""The status of a slot: what a slice says of it."""


@dataclass(frozen=True, slots=True)
class Update:
    """The slice born at `birth`. M is how many slots its statuses call predicted or new.

    The first updates of a stream, of the births 1 - swin_size .. 0, have no slot predicted: they
    say what frame 0 shows.
    """

    birth: int
    statuses: Bytes  # (S,) KEPT, ENDED, PREDICTED or NEW, layer after layer
    states: States  # M, in the order of the slots: what they become, not a difference
    start_offsets: Bytes  # (M,) frames after birth; 0 for the predicted
    escaped: Flags  # (M,) new Gaussians that the lattice does not hold
    escapes: Splats  # those, in order; their states mean nothing

    @staticmethod
    def keeping(birth: int, layout: SlotLayout) -> Update:
        """One that keeps all slots."""
        return Update(
            birth,
            np.zeros(layout.num_slots, np.uint8),
            States.zeros(0, layout.sh_degree),
            np.zeros(0, np.uint8),
            np.zeros(0, np.bool_),
            Splats.empty(layout.sh_degree),
        )

    def check(self, layout: SlotLayout) -> None:
        """Raises InvalidError unless the parts agree and `layout` holds them."""
        what = f"update born at {self.birth}"
        if self.statuses.shape != (layout.num_slots,) or self.statuses.dtype != np.uint8:
            raise InvalidError(
                f"{what}: statuses are {self.statuses.dtype} {self.statuses.shape}, "
                f"not uint8 ({layout.num_slots},)"
            )
        if self.statuses.max() > NEW:
            raise InvalidError(f"{what}: a status is {self.statuses.max()}, at most {NEW}")
        coded = np.flatnonzero(self.statuses >= PREDICTED)
        count, attributes = len(coded), layout.num_planes - 3
        arrays = (
            ("positions", self.states.positions, (count, 3), np.int32),
            ("attributes", self.states.attributes, (count, attributes), np.uint8),
            ("start_offsets", self.start_offsets, (count,), np.uint8),
            ("escaped", self.escaped, (count,), np.bool_),
        )
        for name, array, shape, dtype in arrays:
            if array.shape != shape or array.dtype != dtype:
                raise InvalidError(
                    f"{what}: {name} are {array.dtype} {array.shape}, not {np.dtype(dtype)} {shape}"
                )
        if count and self.start_offsets.max() >= layout.swin_size:
            raise InvalidError(
                f"{what}: start offset {self.start_offsets.max()} of {layout.swin_size} frames"
            )
        if self.start_offsets[self.statuses[coded] == PREDICTED].any():
            raise InvalidError(f"{what}: a predicted Gaussian starts late; it goes on at once")
        if len(self.escapes) != np.count_nonzero(self.escaped):
            raise InvalidError(
                f"{what}: {len(self.escapes)} escapes, "
                f"{np.count_nonzero(self.escaped)} are said to escape"
            )
        if len(self.escapes) and self.escapes.sh_degree != layout.sh_degree:
            raise InvalidError(
                f"{what}: SH degree {self.escapes.sh_degree}, not {layout.sh_degree}"
            )
        if (self.escaped & (self.statuses[coded] == PREDICTED)).any():
            raise InvalidError(f"{what}: a predicted Gaussian escapes; make it a new one")
        inside = self.states.take(~self.escaped)
        if not (abs(inside.positions.astype(np.int64)) < POSITION_LIMIT).all():
            raise InvalidError(f"{what}: a position is outside the lattice; let it escape")
        levels = np.repeat([lattice.opacity_levels for lattice in layout.lattices], layout.slots)
        if (inside.attributes[:, -1] >= levels[coded[~self.escaped]]).any():
            raise InvalidError(f"{what}: an opacity is outside the lattice")
