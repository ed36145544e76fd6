"""One request and what became of it, for the log and the metrics."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

from .request import Request
from .response import Facts

CLIENT_GONE: Final = 499
"""Status logged for a response that its client did not read to the end; it is never sent."""


@dataclass(slots=True)
class Exchange:
    """A request and its response."""

    address: str
    """Address of the peer."""
    began_s: float
    """When its head was whole, by the event loop's clock."""
    method: str = ""
    """Empty where it could not be read."""
    request: Request | None = None
    """None where it could not be read."""
    status: int = 0
    body_bytes: int = 0
    """Bytes of the response's body."""
    first_s: float = 0.0
    """When the response began."""
    waited: bool = False
    """Whether the response could not be given at once."""
    closes: bool = False
    """Whether the connection ends with it."""
    route: str = "unmatched"
    note: str = ""
    """Why it failed; empty if it did not."""
    facts: Facts = field(default_factory=dict)
    """More facts for the log."""
    is_streamed: bool = False
    """Whether the response was made while it was sent."""

    @property
    def is_told(self) -> bool:
        """Whether the log tells of it in any case."""
        return self.is_streamed or self.status >= 400
