"""How often and how soon a broken connection is tried again. Pure."""

from __future__ import annotations

from dataclasses import dataclass

from .fetch import BrokenError


@dataclass(frozen=True, slots=True)
class RetryConfig:
    """Patience with a connection that breaks."""

    attempts: int = 5
    """Tries in a row that may bring nothing before the player gives up."""
    first_delay_s: float = 0.1
    """Before the first new try, seconds; doubled each time."""
    max_delay_s: float = 2.0
    """Longest wait between two tries, seconds."""


class Retry:
    """Counts failures in a row."""

    def __init__(self, config: RetryConfig) -> None:
        self._config = config
        self._failures = 0

    def progress(self) -> None:
        """Something came: what failed before is forgotten."""
        self._failures = 0

    def delay_s(self, error: BrokenError) -> float:
        """How long to wait before the next try. Raises BrokenError when no try is left."""
        self._failures += 1
        if self._failures > self._config.attempts:
            raise BrokenError(f"{error} (given up after {self._config.attempts} new tries)")
        delay_s = self._config.first_delay_s * 2.0 ** (self._failures - 1)
        return min(delay_s, self._config.max_delay_s)
