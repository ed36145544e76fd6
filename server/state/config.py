"""What an operator can set; every default stands here once."""

from __future__ import annotations

from dataclasses import dataclass, field

from codec.errors import InvalidError
from server.abr.session import SessionConfig
from server.http.site import PatienceConfig


@dataclass(frozen=True, slots=True)
class ServerConfig:
    """Limits and times of the HTTP server."""

    session: SessionConfig = field(default_factory=SessionConfig)
    """Pacing of plays."""
    max_plays: int = 256
    """Plays at the same time; one more is answered 503."""
    patience: PatienceConfig = field(default_factory=PatienceConfig)
    """How long clients may take."""
    max_connections: int = 4096
    """Connections at the same time; who comes after that waits to be accepted."""
    shutdown_timeout_s: float = 10.0
    """Seconds that requests in progress get when the server stops."""
    send_queue_bytes: int = 64 * 1024
    """Bytes that may wait unsent for one play: the longer the queue, the staler the choice."""
    cache_bytes: int = 256 * 1024 * 1024
    """Bytes of objects kept in memory."""
    poll_s: float = 0.005
    """Seconds between two looks at what a client has acknowledged."""
    refresh_s: float = 0.5
    """Seconds between two looks at a live stream, or at the folder for new streams."""
    live_idle_s: float = 60.0
    """Seconds that a play waits for new slices of a live stream before it ends."""
    remember_plays: int = 1024
    """Plays whose last estimates are kept when they are over, for clients that come back."""
    remember_s: float = 60.0
    """Seconds that such an estimate is kept."""
    cors_origin: str = "*"
    """Web origin that may read the streams; empty for none."""

    def __post_init__(self) -> None:
        for name in (
            "max_plays",
            "max_connections",
            "shutdown_timeout_s",
            "send_queue_bytes",
            "poll_s",
            "refresh_s",
            "live_idle_s",
        ):
            if not getattr(self, name) > 0:
                raise InvalidError(f"{name} is {getattr(self, name)}; it must be positive")
        for name in ("cache_bytes", "remember_plays", "remember_s"):
            if not getattr(self, name) >= 0:
                raise InvalidError(f"{name} is {getattr(self, name)}; it must not be negative")
        if any(not 0x20 < ord(c) < 0x7F for c in self.cors_origin):
            raise InvalidError("cors_origin is not a web origin; give *, an origin or nothing")
