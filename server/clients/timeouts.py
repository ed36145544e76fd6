"""Timeouts for clients."""

from __future__ import annotations

from dataclasses import dataclass

from codec.errors import InvalidError


@dataclass(frozen=True, slots=True)
class TimeoutConfig:
    """Timeouts and the minimum rate of a client; a client that exceeds one is disconnected."""

    request_timeout_s: float = 8.0
    """Seconds for a complete request, counted from the connection or from its first byte."""
    keepalive_timeout_s: float = 15.0
    """Seconds that an idle connection is kept open between two requests."""
    write_timeout_s: float = 8.0
    """Seconds over which a client must average `least_rate_bytes`; otherwise it is disconnected."""
    least_rate_bytes: float = 1000.0
    """Minimum bytes per second that a client must receive while data waits for it."""

    @property
    def least_s(self) -> float:
        """The shortest of the times."""
        return min(self.request_timeout_s, self.keepalive_timeout_s, self.write_timeout_s)

    def __post_init__(self) -> None:
        for name in ("request_timeout_s", "keepalive_timeout_s", "write_timeout_s"):
            if not 0 < getattr(self, name) <= 86400:
                raise InvalidError(f"{name} is {getattr(self, name)}; give over 0, at most 86400")
        if not 0 <= self.least_rate_bytes <= 1e9:
            raise InvalidError(f"least_rate_bytes is {self.least_rate_bytes}; give 0 to 1e9")
