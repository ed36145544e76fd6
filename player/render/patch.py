"""The changes of a slice to the resident texture, as few rectangles of texels.

Rule: a write costs about as much as some tens of Gaussians, so neighbours are written together with
the unchanged ones between them; that is why the texels of all lanes are kept here, too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from codec.arrays import Floats, Ints
from codec.halfway import Motion
from codec.kernel import kernel
from codec.slice import Slice

from .moves import moves_of, spare_slots
from .pack import pack_slice, texels_per_gaussian

MAX_PATCHES = 128
"""Rectangles that one slice is written as, at most."""

FIRST_GAP = 32
"""Unchanged Gaussians that are written rather than left out by one more rectangle; more where there
would be too many rectangles."""


@dataclass(frozen=True, slots=True)
class Patch:
    """A rectangle of the resident texture, and what belongs there."""

    x_px: int
    y_px: int
    texels: npt.NDArray[np.uint32]  # (height, width, 4), contiguous


@dataclass(frozen=True, slots=True)
class PackedSlice:
    """A slice as its lane takes it."""

    lane: int
    birth: int
    expire: int
    rows: Ints | None  # (N,) rising, those of the lane that change; None: the lane is replaced
    means: Floats  # (N, 3) metres, world
    starts: Ints  # (N,) first frame of each
    patches: tuple[Patch, ...]
    moves: Ints | None = None  # see moves_of
    motion: Motion | None = None

    @property
    def num_bytes(self) -> int:
        return sum(patch.texels.nbytes for patch in self.patches)


@kernel(nogil=True)
def _rectangles(rows, columns, gap, rectangles):  # type: ignore[no-untyped-def]
    """Fills `rectangles` with (top, bottom, left, right), of the grid of `columns` that row after
    row lies in, so that they cover `rows`; returns how many. Each joining adds at most `gap`."""
    count, i = 0, 0
    while i < len(rows):
        first = last = rows[i]
        y = first // columns
        i += 1
        while i < len(rows) and rows[i] - last <= gap + 1 and rows[i] // columns == y:
            last = rows[i]
            i += 1
        left, right = first - y * columns, last + 1 - y * columns
        if count > 0:
            held = rectangles[count - 1]
            low, high = min(held[2], left), max(held[3], right)
            apart = (held[1] - held[0]) * (held[3] - held[2]) + right - left
            if (y + 1 - held[0]) * (high - low) - apart <= gap:
                held[1], held[2], held[3] = y + 1, low, high
                continue
        made = rectangles[count]
        made[0], made[1], made[2], made[3] = y, y + 1, left, right
        count += 1
    return count


def rectangles_of(rows: Ints, columns: int) -> Ints:
    """(M, 4) top, bottom, left, right of at most MAX_PATCHES rectangles that cover `rows`, rising.

    Row r of a lane stands at (r % columns, r // columns).
    """
    rectangles = np.empty((len(rows), 4), np.int32)
    gap, count = FIRST_GAP, _rectangles(rows, columns, FIRST_GAP, rectangles)
    while count > MAX_PATCHES:
        gap *= 2
        count = _rectangles(rows, columns, gap, rectangles)
    return rectangles[:count]


class PackedLanes:
    """Packs slices for the texture; belongs to the thread that puts.

    Invariant: holds each lane's texels as they are when all that was packed so far is uploaded,
    unless the lane is forgotten.
    What is handed out does not change any more, as another thread may be uploading it.
    """

    def __init__(self, swin_size: int, slice_size: int, sh_degree: int, columns: int) -> None:
        """columns: Gaussians in a row of the texture."""
        self._swin_size, self._num_spare = swin_size, spare_slots(slice_size)
        self.texels = texels_per_gaussian(sh_degree)
        """Texels of one Gaussian."""
        self.columns = columns
        self.lane_rows = -(-slice_size // self.columns)
        """Rows of the texture that a lane takes."""
        self._words: list[Floats | None] = [None] * swin_size  # each (Gaussians, 4 * texels)
        self._handed_out = [False] * swin_size
        self._births: list[int | None] = [None] * swin_size

    def pack(self, slice: Slice) -> PackedSlice:
        """The slice, which fits a lane. Raises InvalidError if it changes what its lane lacks."""
        lane = slice.lane(self._swin_size)
        slice.check_follows(self._births[lane], self._swin_size)
        self._births[lane] = slice.birth
        return self._packed(lane, slice)

    def _packed(self, lane: int, slice: Slice) -> PackedSlice:
        rows = slice.rows
        starts = np.empty(len(slice.splats), np.int32)
        if rows is None:
            patches = self._replace(lane, slice, starts)
        else:
            patches = self._change(lane, rows, slice, starts)
        expire = slice.birth + self._swin_size
        means = slice.splats.means
        moves = moves_of(slice, self._num_spare)
        return PackedSlice(
            lane, slice.birth, expire, rows, means, starts, patches, moves, slice.motion
        )

    def forget(self, lane: int) -> None:
        """Packed slices of `lane` may never be uploaded: only a whole slice can follow."""
        self._births[lane] = None

    def _replace(self, lane: int, slice: Slice, starts: Ints) -> tuple[Patch, ...]:
        height = -(-len(slice.splats) // self.columns)
        words = np.zeros((height * self.columns, 4 * self.texels), np.float32)
        pack_slice(slice, words, starts)
        self._words[lane], self._handed_out[lane] = words, True
        texels = words.view(np.uint32).reshape(height, self.columns * self.texels, 4)
        return (Patch(0, lane * self.lane_rows, texels),) if height else ()

    def _change(self, lane: int, rows: Ints, slice: Slice, starts: Ints) -> tuple[Patch, ...]:
        words = self._own_words(lane)
        changed = np.zeros((len(rows), 4 * self.texels), np.float32)
        pack_slice(slice, changed, starts)
        words[rows] = changed
        grid = words.view(np.uint32).reshape(self.lane_rows, self.columns, self.texels, 4)
        patches = []
        for top, bottom, left, right in rectangles_of(rows, self.columns).tolist():
            texels = grid[top:bottom, left:right].copy().reshape(bottom - top, -1, 4)
            patches.append(Patch(left * self.texels, lane * self.lane_rows + top, texels))
        return tuple(patches)

    def _own_words(self, lane: int) -> Floats:
        """The lane's words, of its whole length, to be changed."""
        held = self._words[lane]
        assert held is not None  # the slice before is there
        if self._handed_out[lane]:
            words = np.zeros((self.lane_rows * self.columns, 4 * self.texels), np.float32)
            words[: len(held)] = held
            self._words[lane], self._handed_out[lane] = words, False
            return words
        return held
