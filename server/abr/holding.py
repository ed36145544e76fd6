"""What a client holds of a stream, or will hold when all that was sent has come.

Rule: layers 0..n of a slice are worth something together; a layer without those before it is not.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from itertools import accumulate

from .media import Media


class Holding(ABC):
    """The packets that are there, as far as they are of use."""

    def __init__(self, media: Media, first_frame: int, needed: int = 1) -> None:
        """needed: layers without which a frame does not show."""
        self.media = media
        self.first_frame = first_frame
        self.needed = needed

    @property
    @abstractmethod
    def end_frame(self) -> int:
        """The first frame that cannot show: of the layers that it needs something is not here."""

    @abstractmethod
    def add(self, birth: int, first_layer: int, end_layer: int) -> None:
        """Adds the packets of layers first_layer..end_layer-1 of a slice."""

    @abstractmethod
    def add_snapshots(self, frame: int, first_layer: int, end_layer: int) -> None:
        """Adds the snapshots of these layers at `frame`."""

    @abstractmethod
    def shares(self, frame: int) -> list[float]:
        """How much of each layer shows in `frame`, 0 to 1, never rising from layer to layer."""

    @abstractmethod
    def forget(self, frame: int) -> None:
        """Frames before `frame` are not asked for any more."""

    @abstractmethod
    def is_complete(self, frame: int, end_frame: int) -> bool:
        """Whether all layers are here of all that is born in, or changes, frame..end_frame-1."""

    def layers(self, frame: int) -> float:
        """Layers that show in `frame`; a part of one counts as that part."""
        return sum(self.shares(frame))

    def whole_layers(self, frame: int) -> int:
        """Layers of which nothing is missing in `frame`, whichever slice it comes from."""
        return sum(share >= 1 for share in self.shares(frame))

    def psnr_db(self, frame: int) -> float:
        """What the index promises for `frame` as it shows, dB."""
        gains = self.media.sizes(frame).gains_db
        shares = self.shares(frame)
        # Layer 0 is there, or else the frame does not show.
        return gains[0] + sum(g * s for g, s in zip(gains[1:], shares[1:], strict=True))


class SliceHolding(Holding):
    """Version 1: a slice shows for swin_size frames, whatever the others have."""

    def __init__(self, media: Media, first_frame: int, needed: int = 1) -> None:
        super().__init__(media, first_frame, needed)
        self.first_birth = first_frame - media.swin_size + 1
        self._levels: dict[int, int] = {}
        self._early: dict[int, list[tuple[int, int]]] = {}
        """Layers that came before those under them."""
        self._oldest = self._end_birth = self.first_birth

    @property
    def end_frame(self) -> int:
        return max(self._end_birth, self.first_frame)

    def level(self, birth: int) -> int:
        """How many layers of the slice are here, from layer 0 on."""
        return self._levels.get(birth, 0)

    def add(self, birth: int, first_layer: int, end_layer: int) -> None:
        level = self._levels.get(birth, 0)
        if first_layer > level:
            self._early.setdefault(birth, []).append((first_layer, end_layer))
            return
        level = max(level, end_layer)
        for first, end in sorted(self._early.get(birth, ())):
            level = max(level, end) if first <= level else level
        self._levels[birth] = level
        while self._levels.get(self._end_birth, 0) >= self.needed:
            self._end_birth += 1

    def add_snapshots(self, frame: int, first_layer: int, end_layer: int) -> None:
        raise TypeError("whole slices have no snapshots")

    def shares(self, frame: int) -> list[float]:
        swin_size, levels = self.media.swin_size, self._levels
        counts = [0] * (self.media.num_layers + 1)
        for birth in range(frame - swin_size + 1, frame + 1):
            counts[levels.get(birth, 0)] += 1
        above = list(accumulate(reversed(counts[1:])))
        return [count / swin_size for count in reversed(above)]

    def forget(self, frame: int) -> None:
        # What lies beyond the end is kept: it may join what is there.
        oldest = min(frame - self.media.swin_size + 1, self._end_birth)
        while self._oldest < oldest:
            self._levels.pop(self._oldest, None)
            self._early.pop(self._oldest, None)
            self._oldest += 1

    def is_complete(self, frame: int, end_frame: int) -> bool:
        num_layers = self.media.num_layers
        return all(self.level(birth) == num_layers for birth in range(frame, end_frame))
