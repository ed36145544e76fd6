"""What a connection needs of the application that it belongs to."""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine
from dataclasses import dataclass, field
from typing import Any, Protocol

from codec.errors import InvalidError

from .request import Request
from .response import AnyResponse, Facts, HeadWriter


@dataclass(frozen=True, slots=True)
class PatienceConfig:
    """Timeouts for clients."""

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


@dataclass(slots=True)
class Exchange:
    """One request and what became of it."""

    address: str
    """Of the peer."""
    began_s: float
    """When its head was whole, by the event loop's clock."""
    request: Request | None = None
    """None where it could not be read."""
    status: int = 0
    body_bytes: int = 0
    """Sent of the body, as far as this process sees."""
    first_s: float = 0.0
    """When the response began."""
    waited: bool = False
    """Whether the response could not be given at once."""
    route: str = "unmatched"
    note: str = ""
    """What was wrong with it."""
    facts: Facts = field(default_factory=dict)
    """What the log shall say of it besides."""


class Connection(Protocol):
    """What ends a connection."""

    def check(self, now_s: float) -> None:
        """Ends the connection if its client takes too long. To be called twice a second or so."""
        ...

    def stop(self) -> None:
        """Closes the connection as soon as no response is on its way."""
        ...

    def abort(self) -> None:
        """Ends the connection now."""
        ...


class Site(Protocol):
    """The application, as its connections see it."""

    patience: PatienceConfig
    connections: set[Connection]
    """Those that are open; each enters itself."""
    emptied: asyncio.Event
    """Set when the last of them has closed."""
    heads: HeadWriter
    max_body_bytes: int

    @property
    def stopping(self) -> bool:
        """Whether connections shall end with the response that they are at."""
        ...

    def answer(self, exchange: Exchange) -> AnyResponse | Coroutine[Any, Any, AnyResponse]:
        """The response to `exchange.request`. Neither it nor what it awaits raises, but for
        CancelledError when the client has gone."""
        ...

    def failed(self, exchange: Exchange, error: Exception) -> None:
        """A body that was being made ended with `error`; its connection is cut."""
        ...

    def finished(self, exchange: Exchange, now_s: float) -> None:
        """`exchange` is over."""
        ...

    def sent(self, num_bytes: int) -> None:
        """So many bytes, of whatever response, are on their way."""
        ...

    def cut(self, kind: str) -> None:
        """A connection was ended because its client took too long: "head", "idle", "write"."""
        ...

    def has_room(self) -> bool:
        """Whether one more connection can be had."""
        ...

    def paused(self) -> None:
        """New clients wait, because there is no room or no descriptor."""
        ...

    def admit(self, address: str) -> bytes | None:
        """None if a client may connect, who then counts until `closed`; else what it is told."""
        ...

    def closed(self, address: str) -> None:
        """A connection that was admitted is over."""
        ...
