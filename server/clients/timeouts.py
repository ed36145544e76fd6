"""Timeouts for clients."""

from __future__ import annotations

from dataclasses import dataclass

from codec.errors import InvalidError


@dataclass(frozen=True, slots=True)
class TimeoutConfig:
    """Timeouts of a client; a client that exceeds one is disconnected."""

    request_timeout_s: float = 8.0
    """Seconds for a complete request, counted from the connection or from its first byte."""
    keepalive_timeout_s: float = 15.0
    """Seconds that an idle connection is kept open between two requests."""
    write_timeout_s: float = 60.0
    """Seconds without room for more data, after which a client is disconnected. The kernel measures
    them (TCP_USER_TIMEOUT, Linux only). A client often makes room for 64 KB at a time, so a smaller
    value also disconnects slow readers."""

    @property
    def least_s(self) -> float:
        """The shorter of the times that this process measures."""
        return min(self.request_timeout_s, self.keepalive_timeout_s)

    def __post_init__(self) -> None:
        for name in ("request_timeout_s", "keepalive_timeout_s", "write_timeout_s"):
            if not 0 < getattr(self, name) <= 86400:
                raise InvalidError(f"{name} is {getattr(self, name)}; give over 0, at most 86400")
