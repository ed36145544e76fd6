"""Slices on their way from the thread that brings them to the thread that draws, and the motion
that they bring."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Iterable
from typing import Generic, TypeVar

import numpy as np

from codec.halfway import Motion
from codec.slice import Slice
from codec.splats import Splats

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
