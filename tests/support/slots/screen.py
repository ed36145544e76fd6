"""What a player shows of slices, held against what the stream has."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from codec.slice import Slice
from codec.stream import StreamReader
from tests.support.drawn import same_splats
from tests.support.slots.slot_streams import Shown, gaussians


class Screen:
    """What shows of the slices that an assembler gives, held against what the stream has."""

    def __init__(self, reader: StreamReader, first_frame: int) -> None:
        self._reader = reader
        self._layers = reader.manifest.num_layers
        self._shown = Shown(reader.manifest)
        self._swin_size = reader.manifest.swin_size
        self.next_frame = first_frame
        self._whole: dict[int, int] = {}  # by lane: layers that show whole

    def put(self, slices: Sequence[Slice], whole: int) -> None:
        """Shows the next frame, and checks that of each lane the layers that are whole are there,
        and that nothing is there which the stream has not.

        whole: layers of which nothing is missing in this frame. What was mended shows lane by
        lane, with the next slice of each.
        """
        frame, self.next_frame = self.next_frame, self.next_frame + 1
        splats = self._shown.after(slices, frame)
        for slice in slices:
            self._whole[slice.birth % self._swin_size] = whole
        for lane, before in self._whole.items():
            self._whole[lane] = min(before, whole)
        everything = self._reader.active_splats(frame, self._layers)
        assert gaussians(splats) <= gaussians(everything)
        least: Counter[bytes] = Counter()
        for one in self._reader.window(frame, self._layers):
            layers = self._whole[one.birth % self._swin_size]
            rows = np.flatnonzero(one.active(frame, self._swin_size))
            rows = rows[rows < self._reader.manifest.slot_layout.row_edges[layers]]
            least += gaussians(one.splats.take(rows))
        assert least <= gaussians(splats)
        if set(self._whole.values()) == {self._layers}:
            assert same_splats(splats, everything)
