"""The packets of a stream that a client holds, or will hold when everything sent has arrived.

Rule: a change is usable only after the change before it. So the usable part of a layer is a chain:
from the frame of a keyframe to the last change that follows without a gap. After the chain's end
the layer decays by the share that each slice would have changed. Layers 0..n are usable together; a
layer without all lower layers is not.
"""

from __future__ import annotations

from itertools import accumulate

from .media import Media


class Holding:
    """The usable part of the packets that a client holds."""

    def __init__(self, media: Media, first_frame: int, needed: int = 1) -> None:
        """A client that begins to play with `first_frame` holds nothing yet. needed: layers
        without which a frame does not show."""
        self.media = media
        self._chains: list[list[list[int]]] = [[] for _ in range(media.num_layers)]
        """The chains [first frame, last birth] of each layer, in order."""
        self._ends = [first_frame] * needed

    @property
    def end_frame(self) -> int:
        """The first frame that cannot show: a layer that it needs is incomplete."""
        return min(self._ends)

    def end_birth(self, layer: int) -> int | None:
        """The birth after the last one of this layer's last chain; None where it has none."""
        chains = self._chains[layer]
        return chains[-1][1] + 1 if chains else None

    def end_birth_from(self, layer: int, frame: int) -> int | None:
        """The birth after the last one of this layer's last chain that begins at or before `frame`;
        None where it has none."""
        for first, last in reversed(self._chains[layer]):
            if first <= frame:
                return last + 1
        return None

    def add(self, birth: int, first_layer: int, end_layer: int) -> None:
        """Adds the packets of layers first_layer..end_layer-1 of a slice."""
        for layer in range(first_layer, end_layer):
            chains = self._chains[layer]
            for chain in chains:
                if chain[1] == birth - 1:
                    chain[1] = birth
            self._join(layer)
        self._reach()

    def add_keyframes(self, frame: int, first_layer: int, end_layer: int) -> None:
        """Adds the keyframes of these layers at `frame`."""
        for layer in range(first_layer, end_layer):
            chains = self._chains[layer]
            if not any(first <= frame <= last for first, last in chains):
                chains.append([frame, frame])
                chains.sort()
        self._reach()

    def _reach(self) -> None:
        """Notes how far the layers that are needed go without a gap: a later keyframe does not fill
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
        """How much of each layer shows in `frame`, 0 to 1, never rising from layer to layer."""
        layers = range(self.media.num_layers)
        return list(accumulate((self.fresh(layer, frame) for layer in layers), min))

    def layers(self, frame: int) -> float:
        """Layers that show in `frame`; a part of one counts as that part."""
        return sum(self.shares(frame))

    def whole_layers(self, frame: int) -> int:
        """Layers of which nothing is missing in `frame`, whichever slice it comes from."""
        return sum(share >= 1 for share in self.shares(frame))

    def psnr_db(self, frame: int) -> float:
        """PSNR of `frame` with the held packets, by the index, dB."""
        gains = self.media.sizes(frame).gains_db
        shares = self.shares(frame)
        # Layer 0 is there, or else the frame does not show.
        return gains[0] + sum(g * s for g, s in zip(gains[1:], shares[1:], strict=True))

    def is_complete(self, frame: int, end_frame: int) -> bool:
        """Whether all layers are here of all that is born in, or changes, frame..end_frame-1."""
        return all(
            any(first <= frame and last >= end_frame - 1 for first, last in chains)
            for chains in self._chains
        )

    def forget(self, frame: int) -> None:
        """Frames before `frame` are not asked for any more."""
        for chains in self._chains:
            while len(chains) > 1 and chains[1][0] <= frame:
                del chains[0]
