"""Compares the Gaussians that a player shows with those of the stream."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from codec.slice import Slice
from codec.stream import StreamReader
from tests.support.drawn import same_splats
from tests.support.slots.slot_streams import Shown, gaussians


class Screen:
    """Shows the slices of an assembler, and compares them with the stream."""

    def __init__(self, reader: StreamReader, first_frame: int) -> None:
        self._reader = reader
        self._layers = reader.manifest.num_layers
        self._shown = Shown(reader.manifest)
        self._swin_size = reader.manifest.swin_size
        self.next_frame = first_frame
        self._whole: dict[int, int] = {}  # by lane: number of complete layers that show

    def put(self, slices: Sequence[Slice], whole: int) -> None:
        """Shows the next frame; checks that the complete layers of each lane are there, and that
        there is nothing that the stream does not have.

        whole: number of complete layers in this frame. A repair shows lane by lane, with the next
        slice of each lane.
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
