"""The way of an update from the thread that brings slices to the one that draws, and the changes
that it makes in the memory of a renderer: rows, lanes, rectangles of texels, moves.

Rule: whatever does not depend on the camera is computed here once for a slice, not for each frame.
A Gaussian is a row of texels, four words of 32 bits each. A write costs about as much as some tens
of Gaussians, so neighbours are written together with the unchanged ones between them; that is why
the texels of all lanes are kept here, too.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
import numpy.typing as npt

from codec.arrays import Floats, Ints
from codec.errors import InvalidError
from codec.kernel import kernel
from codec.slice import HIDDEN, Motion, Slice
from codec.splats import SH_C0, Splats, sh_count

from .project import ALPHA_MIN, rotation_of


def check_slice(slice: Slice, slice_size: int, sh_degree: int) -> None:
    """Raises InvalidError unless `slice` fits a lane of `slice_size` Gaussians of `sh_degree`."""
    if len(slice.splats) > slice_size:
        raise InvalidError(
            f"the slice born at {slice.birth} has {len(slice.splats)} Gaussians; "
            f"a lane holds {slice_size}"
        )
    if slice.rows is not None and len(slice.rows) and slice.rows[-1] >= slice_size:
        raise InvalidError(
            f"the slice born at {slice.birth} changes row {slice.rows[-1]}; "
            f"a lane has {slice_size} rows"
        )
    if slice.splats.sh_degree != sh_degree:
        raise InvalidError(
            f"the slice born at {slice.birth} has SH degree {slice.splats.sh_degree}, "
            f"the stream has {sh_degree}"
        )


MOVES, ENTERS, LEAVES = 1, 2, 3
"""Kinds of motion: a slot moves from its previous place; a Gaussian fades in; the slot's previous
Gaussian fades out."""

LEAVING_AT = 8
"""First bit of the number of the spare slot, from 1, in which the previous Gaussian fades out."""

LEAST_SPARE, SPARE_SHARE = 64, 16
"""Gaussians that can fade out at once: the least number, and the part of a lane. In a trained
stream 1 to 2 % of a lane do; what is more vanishes at once."""


def spare_slots(slice_size: int) -> int:
    """Slots behind those of the lanes, for Gaussians that fade out."""
    return min(slice_size, max(LEAST_SPARE, slice_size // SPARE_SHARE))


def moves_of(slice: Slice, num_spare: int) -> Ints | None:
    """(N,) for each of the slice's rows MOVES, ENTERS or 0, and from the bit LEAVING_AT on the
    spare slot of the one before it; None where its motion is not known."""
    rows, motion = slice.rows, slice.motion
    if rows is None or motion is None:
        return None
    moves = np.zeros(len(rows), np.int32)
    moves[np.searchsorted(rows, motion.rows)] = np.where(motion.enters, ENTERS, MOVES)
    left = motion.left[:num_spare]
    moves[np.searchsorted(rows, left)] |= np.arange(1, len(left) + 1, dtype=np.int32) << LEAVING_AT
    return moves


TEXTURE_WIDTH_PX = 2048
"""Widest row of the resident texture; every GL 3.3 driver takes it."""

NEVER = np.iinfo(np.int32).max
"""Start of a Gaussian that no frame shows."""


COLOUR_COLUMNS = 2048
"""Gaussians in a row of the texture of colours that harmonics of degree 2 and 3 give."""


def texels_per_gaussian(sh_degree: int) -> int:
    """Texels of four words: mean 3, opacity, covariance 6, colour 3, harmonics 3 each from degree 1
    on; the last two words are free."""
    return -(-(15 + 3 * (sh_count(sh_degree) - 1)) // 4)


@kernel(nogil=True)
def _pack_rows(  # type: ignore[no-untyped-def]
    means, log_scales, quats, logit_opacities, sh, birth, offsets, words, starts
):
    half, one, c0 = np.float32(0.5), np.float32(1), np.float32(SH_C0)
    alpha_min = np.float32(ALPHA_MIN)
    for i in range(means.shape[0]):
        opacity = one / (one + np.exp(-logit_opacities[i]))
        # One that is nowhere opaque enough to show is left out of every frame.
        shows = opacity >= alpha_min and offsets[i] != HIDDEN
        starts[i] = birth + offsets[i] if shows else NEVER
        qw, qx, qy, qz = quats[i, 0], quats[i, 1], quats[i, 2], quats[i, 3]
        norm = one / np.sqrt(qw * qw + qx * qx + qy * qy + qz * qz)
        r00, r01, r02, r10, r11, r12, r20, r21, r22 = rotation_of(
            qw * norm, qx * norm, qy * norm, qz * norm
        )
        s0, s1, s2 = np.exp(log_scales[i, 0]), np.exp(log_scales[i, 1]), np.exp(log_scales[i, 2])
        r00, r01, r02 = r00 * s0, r01 * s1, r02 * s2
        r10, r11, r12 = r10 * s0, r11 * s1, r12 * s2
        r20, r21, r22 = r20 * s0, r21 * s1, r22 * s2
        words[i, 0], words[i, 1], words[i, 2] = means[i, 0], means[i, 1], means[i, 2]
        words[i, 3] = opacity
        words[i, 4] = r00 * r00 + r01 * r01 + r02 * r02
        words[i, 5] = r00 * r10 + r01 * r11 + r02 * r12
        words[i, 6] = r00 * r20 + r01 * r21 + r02 * r22
        words[i, 7] = r10 * r10 + r11 * r11 + r12 * r12
        words[i, 8] = r10 * r20 + r11 * r21 + r12 * r22
        words[i, 9] = r20 * r20 + r21 * r21 + r22 * r22
        for c in range(3):
            words[i, 10 + c] = half + c0 * sh[i, 0, c]
        for k in range(sh.shape[1] - 1):
            for c in range(3):
                words[i, 13 + 3 * k + c] = sh[i, 1 + k, c]


def pack_slice(slice: Slice, words: Floats, starts: Ints) -> None:
    """Fills `words` (N, 4 * texels) and `starts` (N,), first frames, with the slice's Gaussians."""
    splats = slice.splats
    _pack_rows(
        splats.means,
        splats.log_scales,
        splats.quats,
        splats.logit_opacities,
        splats.sh,
        np.int32(slice.birth),
        slice.start_offsets,
        words,
        starts,
    )


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


Item = TypeVar("Item")


class Arrivals(Generic[Item]):
    """Holds each slice until a frame at or after its birth is uploaded.

    Until then its lane belongs to a slice that still shows. None is left out, as a later one may
    change only some of its rows. The caller must keep the queue short: the update thread waits for
    the render thread when it is a few frames ahead.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._waiting: deque[tuple[int, Item]] = deque()

    def append(self, birth: int, item: Item) -> None:
        """Adds the slice born at `birth`."""
        with self._lock:
            self._waiting.append((birth, item))

    def pop_until(self, frame: int) -> list[Item]:
        """The slices born at or before `frame`, in order."""
        taken = []
        with self._lock:
            while self._waiting and self._waiting[0][0] <= frame:
                taken.append(self._waiting.popleft()[1])
        return taken

    def drop(self) -> list[Item]:
        """Forgets what waits, and gives it: another place in the stream is wanted."""
        with self._lock:
            dropped = [item for _, item in self._waiting]
            self._waiting.clear()
        return dropped


class Glide:
    """The changes of the newest uploaded slice, and the share of their way that is drawn."""

    def __init__(self) -> None:
        self._moving: list[tuple[int, Motion]] = []
        self._share = 1.0

    def start(self, frame: int, uploaded: Iterable[tuple[int, Motion | None]]) -> None:
        """All that was uploaded, by birth, is where it belongs; what the slice born at `frame`
        changes may be drawn on its way."""
        self._share = 1.0
        self._moving = [
            (birth, motion) for birth, motion in uploaded if birth == frame and motion is not None
        ]

    def to(self, share: float) -> tuple[list[Slice], list[Splats]]:
        """Slices that put all at `share` of the way, 0 to 1, from where it was, and the Gaussians
        that still fade out there. The slices correct those of their lanes. Nothing if all is there
        already."""
        if share == self._share or not self._moving:
            return [], []
        self._share = share
        corrections = [
            Slice(birth, motion.at(share), np.zeros(len(motion.rows), np.uint8), motion.rows)
            for birth, motion in self._moving
        ]
        return corrections, [motion.leaving_at(share) for _, motion in self._moving]
