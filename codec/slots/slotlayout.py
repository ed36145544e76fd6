"""The slots of a stream: how many, on which lattice, and how large their chunks can be."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import accumulate

from codec.errors import InvalidError
from codec.lattice.floats import bytes_per_gaussian
from codec.lattice.lattice import Lattice, num_attributes
from codec.slice import MAX_SWIN_SIZE
from codec.splats import MAX_SH_DEGREE

from .rangecoder import CODE_BYTES

MAX_SLOTS = 1 << 20
"""Slots in a lane, all layers together."""

MAX_SLOTS_OF_LANES = 1 << 24
"""Slots in all lanes together."""

MAX_SEGMENT_SLOTS = 1 << 28
"""Slots of a lane times frames in a segment: bounds what the masks of a segment inflate to."""

MAX_MASK_BYTES_PER_SLOT = 4
"""Three bits at most, each of which costs 10.5 at most: a probability stays above 3 in 4096."""

MAX_LAYERS = 16
"""Layers of a slice: what a manifest, an index record and a chunk may name."""

MAX_SEGMENT_FRAMES = 4096

HEADER_BYTES = 12
"""In front of every chunk."""

COUNTS_BYTES = 20
"""In front of every change, and behind the flags of a snapshot."""

MAX_SLOT_CHUNK_BYTES = 64 + 248_512_560
"""The largest chunk, whatever the layout."""


@dataclass(frozen=True, slots=True)
class SlotLayout:
    """Layout by which masks, changes and snapshots are read. Raises InvalidError for a layout that
    the format does not allow."""

    swin_size: int
    """Lanes, and frames that a lease lasts."""
    slots: tuple[int, ...]
    """Slots of a lane in each layer."""
    sh_degree: int
    lattices: tuple[Lattice, ...]
    """The lattice of each layer."""
    segment_frames: int
    """Frames in a segment: masks and snapshots begin anew with each."""

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
    def max_mask_bytes(self) -> int:
        """Bytes of the longest mask, before the entropy coder."""
        return HEADER_BYTES + CODE_BYTES + MAX_MASK_BYTES_PER_SLOT * self.num_slots

    def max_change_bytes(self, layer: int) -> int:
        """Bytes of the longest change of `layer`: all new, all escaped."""
        most = HEADER_BYTES + COUNTS_BYTES + self.slots[layer] * self._max_slot_bytes
        return min(most, MAX_SLOT_CHUNK_BYTES)

    def max_snapshot_bytes(self, layer: int) -> int:
        """Bytes of the longest snapshot of `layer`."""
        count = self.swin_size * self.slots[layer]
        most = HEADER_BYTES + self.flags_bytes(layer) + COUNTS_BYTES + count * self._max_slot_bytes
        return min(most, MAX_SLOT_CHUNK_BYTES)

    def flags_bytes(self, layer: int) -> int:
        """Bytes of the flags in a snapshot of `layer`: a bit for each slot of each lane."""
        return (self.swin_size * self.slots[layer] + 7) // 8

    @property
    def _max_slot_bytes(self) -> int:
        """Largest size of a new Gaussian: its planes, 24 low bits for each axis, the number and the
        floats of an escape, the start offset. A predicted one takes less."""
        return self.num_planes + 9 + 4 + bytes_per_gaussian(self.sh_degree) + 1
