"""How long and how soon a connection that broke is tried again. Pure."""

from __future__ import annotations

from dataclasses import dataclass

from codec.errors import InvalidError

from .faults import BrokenError


@dataclass(frozen=True, slots=True)
class RetryConfig:
    """Patience with a server that fails."""

    patience_s: float = 60.0
    """Seconds of tries that bring nothing after which the player gives up; 0: at once."""
    first_delay_s: float = 0.1
    """Before the first new try, seconds; doubled each time."""
    max_delay_s: float = 2.0
    """Longest wait between two tries, seconds, unless the server asks for a longer one."""

    def __post_init__(self) -> None:
        if not 0 <= self.patience_s <= 86400:
            raise InvalidError(f"patience {self.patience_s} s is not within 0..86400 s")


class Retry:
    """The failures since something of use came last."""

    def __init__(self, config: RetryConfig) -> None:
        self._config = config
        self._failures = 0
        self._since_s = 0.0

    def progress(self) -> None:
        """Something of use came: what failed before is forgotten."""
        self._failures = 0

    def delay_s(self, error: BrokenError, now_s: float, chance: float) -> float:
        """How long to wait before the next try. chance: 0 to 1, so that not all clients come back
        at the same moment. Raises BrokenError when the patience is over."""
        config = self._config
        if not self._failures:
            self._since_s = now_s
        tried_s = now_s - self._since_s
        left_s = config.patience_s - tried_s
        self._failures += 1
        if left_s <= 0:
            tried = f" (tried for {tried_s:.3g} s, {self._failures} times)" if tried_s else ""
            raise BrokenError(f"{error}{tried}")
        delay_s = min(config.first_delay_s * 2.0 ** min(self._failures - 1, 60), config.max_delay_s)
        delay_s *= 0.5 + 0.5 * chance
        # The last try is at the end of the patience, whatever the server asks for.
        return min(max(delay_s, error.retry_after_s or 0.0), left_s)
