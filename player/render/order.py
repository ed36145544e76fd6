"""Which Gaussians show in a frame, farthest first.

Rule: this is the CPU renderer's order from back to front, equally far ones included. Of a Gaussian
that was split in two both parts may stand at the same place after quantisation.
"""

from __future__ import annotations

import numpy as np

from codec.arrays import Doubles, Floats, Ints
from codec.kernel import kernel

from .blend import radix_sort
from .project import depth_of
from .upload import NEVER


@kernel(nogil=True)
def _collect(means, starts, expires, counts, spare, frame, view, near_m, slots, keys):  # type: ignore[no-untyped-def]
    lanes, lane_slots = starts.shape
    found = 0
    for i in range(spare.shape[0]):
        z = depth_of(view[0], view[1], view[2], view[3], spare[i, 0], spare[i, 1], spare[i, 2])
        if z > near_m:
            slots[found] = lanes * lane_slots + i
            keys[found] = z
            found += 1
    # Newest slice and last row first: of equally far ones the CPU renderer, which goes from front
    # to back, has the oldest and first in front.
    for age in range(lanes):
        lane = (frame - age) % lanes
        # After a seek backwards a lane may hold what is yet to come.
        if expires[lane] <= frame or frame < expires[lane] - lanes:
            continue
        for i in range(counts[lane] - 1, -1, -1):
            x, y, z = means[lane, i, 0], means[lane, i, 1], means[lane, i, 2]
            z = depth_of(view[0], view[1], view[2], view[3], x, y, z)
            if starts[lane, i] <= frame and z > near_m:
                slots[found] = lane * lane_slots + i
                keys[found] = z
                found += 1
    return found


class Order:
    """The visible order of a window of Gaussians; all its buffers are made once."""

    def __init__(self, swin_size: int, slice_size: int, num_spare: int = 0) -> None:
        """num_spare: the most that `spare` may hold."""
        total = swin_size * slice_size + num_spare
        self.spare = np.zeros((0, 3), np.float32)
        """(L, 3) metres: Gaussians behind the lanes, which show in every frame."""
        self.means = np.zeros((swin_size, slice_size, 3), np.float32)
        self.starts = np.full((swin_size, slice_size), NEVER, np.int32)
        self.expires = np.full(swin_size, np.iinfo(np.int32).min, np.int32)
        self.counts = np.zeros(swin_size, np.int32)
        self._slots = (np.empty(total, np.int32), np.empty(total, np.int32))
        self._depths = (np.empty(total, np.float32), np.empty(total, np.float32))

    def update_lane(
        self, lane: int, expire: int, means: Floats, starts: Ints, rows: Ints | None = None
    ) -> None:
        """Replaces the Gaussians of `lane`, which show in frames starts <= frame < expire.

        With `rows`, rising, only those; the others go on until `expire`, and what of them shows at
        all does so from expire - swin_size on. Where the lane has that slice already, the others
        stay as they are.
        """
        count = len(means)
        if rows is not None and self.expires[lane] == expire:
            self.means[lane][rows] = means
            self.starts[lane][rows] = starts
            return
        self.expires[lane] = expire
        if rows is None:
            self.means[lane, :count] = means
            self.starts[lane, :count] = starts
            self.counts[lane] = count
            return
        held = int(self.counts[lane])
        kept = self.starts[lane, :held]
        np.minimum(kept, np.int32(expire - len(self.starts)), out=kept, where=kept != NEVER)
        if count:
            self.counts[lane] = max(held, rows[-1] + 1)
            # What a longer slice left there.
            self.starts[lane, held : self.counts[lane]] = NEVER
        self.means[lane][rows] = means
        self.starts[lane][rows] = starts

    def far_first(self, frame: int, w2c: Doubles, near_m: float) -> Ints:
        """(M,) int32 slots, lane * slice_size + row, to draw; valid until the next call."""
        view = w2c[2].astype(np.float32)
        found = _collect(
            self.means,
            self.starts,
            self.expires,
            self.counts,
            self.spare,
            np.int32(frame),
            view,
            np.float32(near_m),
            self._slots[0],
            self._depths[0],
        )
        keys = [depths[:found].view(np.uint32) for depths in self._depths]
        slots = [slots[:found] for slots in self._slots]
        np.invert(keys[0], out=keys[0])  # farthest first
        radix_sort(keys[0], slots[0], keys[1], slots[1])
        return slots[1]
