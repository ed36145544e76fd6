"""Values in memory, bounded in bytes: the least recently used goes."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Hashable
from typing import Generic, TypeVar

K = TypeVar("K", bound=Hashable)
V = TypeVar("V")


class ByteCache(Generic[K, V]):
    """Holds values of at most `capacity_bytes` in all. What was dropped here lives on where it is
    in use."""

    def __init__(self, capacity_bytes: int) -> None:
        self._capacity_bytes = capacity_bytes
        self._held: OrderedDict[K, tuple[V, int]] = OrderedDict()  # with its bytes
        self.size_bytes = 0

    def get(self, key: K) -> V | None:
        found = self._held.get(key)
        if found is None:
            return None
        self._held.move_to_end(key)
        return found[0]

    def keep(self, key: K, value: V, num_bytes: int) -> None:
        """Holds `value` in place of what had this key, unless it is too large by itself."""
        _, before_bytes = self._held.pop(key, (None, 0))
        self.size_bytes -= before_bytes
        if num_bytes > self._capacity_bytes:
            return
        self._held[key] = value, num_bytes
        self.size_bytes += num_bytes
        while self.size_bytes > self._capacity_bytes:
            _, (_, dropped_bytes) = self._held.popitem(last=False)
            self.size_bytes -= dropped_bytes
