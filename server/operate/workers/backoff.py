"""When a worker that died is started again: at once, and later if it dies again soon. Pure."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from codec.errors import InvalidError


@dataclass(frozen=True, slots=True)
class BackoffConfig:
    """Delays before the supervisor restarts workers that died."""

    first_s: float = 0.1
    """Seconds before the second restart in a row; each further restart doubles the delay."""
    max_s: float = 10.0
    """Maximum delay of a restart, in seconds."""
    settle_s: float = 5.0
    """Seconds of life after which the death of a worker counts as the first in a row again."""

    def __post_init__(self) -> None:
        if not 0 < self.first_s <= self.max_s < float("inf"):
            raise InvalidError(
                f"first_s is {self.first_s} and max_s {self.max_s}; give 0 < first_s <= max_s"
            )
        if not 0 < self.settle_s < float("inf"):
            raise InvalidError(f"settle_s is {self.settle_s}; it must be positive")


class Backoff:
    """What is known of the deaths of one worker and its successors."""

    def __init__(self, config: BackoffConfig, random: Callable[[], float]) -> None:
        """random: gives numbers from 0 to 1, so that workers do not start in step."""
        self._config = config
        self._random = random
        self._in_row = 0

    def died(self, lived_s: float) -> float:
        """Seconds to wait before the next one is started."""
        config = self._config
        self._in_row = 1 if lived_s >= config.settle_s else self._in_row + 1
        if self._in_row == 1:
            return 0.0
        # 2^64 would be no float to multiply with; nobody waits so long.
        doubled = config.first_s * 2.0 ** min(self._in_row - 2, 64)
        return min(config.max_s, doubled * (0.75 + 0.5 * self._random()))
