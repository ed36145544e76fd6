"""The reports of a training while it runs: its progress, and each window that it has trained."""

from __future__ import annotations

from dataclasses import dataclass

from codec.slice import Slice
from codec.slots.slotlayout import Update


@dataclass(frozen=True, slots=True)
class Progress:
    """Where training stands."""

    first_frame: int  # of the window
    iteration: int  # done in this window
    iterations: int  # of this window
    loss: float


@dataclass(frozen=True, slots=True)
class Window:
    """A window that has been trained, and what matured with it."""

    frames: range
    """The frames it was trained on."""
    slices: tuple[Slice, ...] = ()
    """Slices that no later window changes, in the order of birth: after genesis all that show in
    frame 0, then one at a time."""
    updates: tuple[Update, ...] = ()
    """The same where slots are leased; then there are no slices."""

    @property
    def first_frame(self) -> int:
        """The frame that is finished: no later window changes it."""
        return self.frames.start


class Observer:
    """Callbacks of a training. Subclasses override those that they need."""

    def window_begun(self, first_frame: int, done: int) -> None:
        """The window that begins with `first_frame` is about to be trained. done: its iterations
        that a restored state has behind it."""

    def progressed(self, progress: Progress) -> None:
        """Some more iterations of the window are done."""

    def window_ended(self, first_frame: int) -> None:
        """The window's slices have been taken, and the next window has been asked for."""
