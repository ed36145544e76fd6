"""What a client holds where slots last (format version 2): chains of changes behind snapshots.

Rule: a change is worth something only behind the one before it. So what is here of a layer is a
chain: from the frame of a snapshot to the last change that follows without a gap. Behind its end
the layer wears away, by what each slice would have changed.
"""

from __future__ import annotations

from itertools import accumulate

from .holding import Holding, SliceHolding
from .media import Media


class SlotHolding(Holding):
    """Version 2."""

    def __init__(self, media: Media, first_frame: int, needed: int = 1) -> None:
        super().__init__(media, first_frame, needed)
        self._chains: list[list[list[int]]] = [[] for _ in range(media.num_layers)]
        """Of each layer the chains [first frame, last birth], in order."""
        self._ends = [first_frame] * needed

    @property
    def end_frame(self) -> int:
        return min(self._ends)

    def end_birth(self, layer: int) -> int | None:
        """The birth after the last one of this layer's last chain; None where it has none."""
        chains = self._chains[layer]
        return chains[-1][1] + 1 if chains else None

    def add(self, birth: int, first_layer: int, end_layer: int) -> None:
        for layer in range(first_layer, end_layer):
            for chain in self._chains[layer]:
                if chain[1] == birth - 1:
                    chain[1] = birth
            self._join(layer)
        self._reach()

    def add_snapshots(self, frame: int, first_layer: int, end_layer: int) -> None:
        for layer in range(first_layer, end_layer):
            chains = self._chains[layer]
            if not any(first <= frame <= last for first, last in chains):
                chains.append([frame, frame])
                chains.sort()
        self._reach()

    def _reach(self) -> None:
        """Notes how far the layers that are needed go without a gap: a later snapshot does not fill
        one."""
        for layer, end in enumerate(self._ends):
            for first, last in self._chains[layer]:
                if first <= end:
                    end = max(end, last + 1)
            self._ends[layer] = end

    def _join(self, layer: int) -> None:
        """Makes one of two chains of which the first has grown into the second."""
        chains = self._chains[layer]
        for n in range(len(chains) - 1, 0, -1):
            if chains[n - 1][1] >= chains[n][0]:
                chains[n - 1][1] = max(chains[n - 1][1], chains[n][1])
                del chains[n]

    def fresh(self, layer: int, frame: int) -> float:
        """Share of the layer that is known at `frame`."""
        for first, last in reversed(self._chains[layer]):
            if first <= frame:
                share = 1.0
                for birth in range(last + 1, frame + 1):
                    share *= 1 - self.media.sizes(birth).changed_shares[layer]
                    if share < 1e-3:
                        return 0.0
                return share
        return 0.0

    def shares(self, frame: int) -> list[float]:
        layers = range(self.media.num_layers)
        return list(accumulate((self.fresh(layer, frame) for layer in layers), min))

    def is_complete(self, frame: int, end_frame: int) -> bool:
        return all(
            any(first <= frame and last >= end_frame - 1 for first, last in chains)
            for chains in self._chains
        )

    def forget(self, frame: int) -> None:
        for chains in self._chains:
            while len(chains) > 1 and chains[1][0] <= frame:
                del chains[0]


def open_holding(media: Media, first_frame: int, needed: int = 1) -> Holding:
    """What a client holds that begins to play with `first_frame`: nothing yet. needed: layers
    without which a frame does not show."""
    return (SlotHolding if media.has_slots else SliceHolding)(media, first_frame, needed)
