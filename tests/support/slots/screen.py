"""What a player shows of slices, held against what the stream has."""

from __future__ import annotations

from collections import Counter

import numpy as np

from codec.slice import window_births
from codec.stream import StreamReader
from player.source.source import ReceivedSlice
from tests.support.slots.slot_streams import Shown, gaussians, same_splats


class Screen:
    """What shows of the slices that a receiver hands out, held against what the stream has."""

    def __init__(self, reader: StreamReader, first_frame: int) -> None:
        self._reader = reader
        self._first_frame = first_frame
        self._layers = reader.manifest.num_layers
        self._shown = Shown(reader.manifest)
        self._swin_size = reader.manifest.swin_size
        self.next_birth = window_births(first_frame, self._swin_size).start
        self._known: dict[int, int] = {}  # by lane: layers that show whole
        self._whole_until = self.next_birth + self._swin_size

    def snapshots_came(self) -> None:
        """The next slice of each lane is whole."""
        self._whole_until = self.next_birth + self._swin_size

    def put(self, received: ReceivedSlice, held: int) -> None:
        """Shows a slice, and checks that of each lane the layers that came whole are there, and
        that nothing is there which the stream has not.

        held: layers that the receiver knows whole.
        """
        slice, birth = received.slice, received.slice.birth
        assert birth == self.next_birth
        assert (slice.rows is None) == (birth < self._whole_until)
        self.next_birth += 1
        lane = birth % self._swin_size
        self._known[lane] = held if slice.rows is None else min(held, self._known[lane])
        splats = self._shown.after([slice], birth)
        if birth < self._first_frame:
            return
        everything = self._reader.active_splats(birth, self._layers)
        assert gaussians(splats) <= gaussians(everything)
        least: Counter[bytes] = Counter()
        for one in self._reader.window(birth, self._layers):
            layers = self._known[one.birth % self._swin_size]
            rows = np.flatnonzero(one.active(birth, self._swin_size))
            rows = rows[rows < self._reader.manifest.slot_layout.row_edges[layers]]
            least += gaussians(one.splats.take(rows))
        assert least <= gaussians(splats)
        if set(self._known.values()) == {self._layers}:
            assert same_splats(splats, everything)
