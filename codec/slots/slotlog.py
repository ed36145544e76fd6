"""The log that a decoder keeps of a layer of a lane while something of it is missing."""

from __future__ import annotations

from dataclasses import dataclass, field

from codec.arrays import Bytes

from .slotstate import Slots
from .update import PREDICTED


@dataclass(slots=True)
class SlotLog:
    """A layer of a lane since something of it was missing: the slices to apply again when it
    comes."""

    before: Slots | None
    """The slots before those slices; None if all were unknown."""
    since: dict[int, tuple[Bytes, bytes | None]] = field(default_factory=dict)
    """By birth the statuses and the change of every slice of the lane since then."""

    @property
    def num_bytes(self) -> int:
        changes = sum(len(change) for _, change in self.since.values() if change is not None)
        before = 0 if self.before is None else self.before.num_bytes
        return before + sum(s.nbytes for s, _ in self.since.values()) + changes

    @property
    def is_waiting(self) -> bool:
        """Whether any change is missing."""
        return any(map(self.waits_for, self.since))

    def waits_for(self, birth: int) -> bool:
        """Whether the change of `birth` is missing, and would alter something."""
        statuses, change = self.since.get(birth, (None, None))
        return statuses is not None and change is None and bool((statuses >= PREDICTED).any())
