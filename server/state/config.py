"""The operator's settings; every default is defined once, here or beside the code that uses it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

from codec.console import Constant
from codec.errors import InvalidError
from server.abr.session import SessionConfig
from server.operate.admission import AdmissionConfig, parse_proxies
from server.operate.log import LogRequests, LogStyle
from server.operate.overload import OverloadConfig
from server.operate.workers import SupervisorConfig
from server.study.choice import OWN, check_policy


@dataclass(frozen=True, slots=True)
class TimeoutConfig:
    """Timeouts of a client; a client that exceeds one is disconnected."""

    keepalive_timeout_s: float = 15.0
    """Seconds that a connection may wait for a whole request, counted from its beginning, or from
    the response before."""
    write_timeout_s: float = 60.0
    """Seconds without room for more data, after which a client is disconnected. The kernel measures
    them (TCP_USER_TIMEOUT, Linux only). A client often makes room for 64 KB at a time, so a smaller
    value also disconnects slow readers."""

    def __post_init__(self) -> None:
        for name in ("keepalive_timeout_s", "write_timeout_s"):
            if not 0 < getattr(self, name) <= 86400:
                raise InvalidError(f"{name} is {getattr(self, name)}; give over 0, at most 86400")


@dataclass(frozen=True, slots=True)
class ServerConfig:
    """Limits and times of the server. What counts or holds something does so in each worker."""

    max_lead_s: float = SessionConfig().max_lead_s
    """Maximum seconds of media sent ahead of the frame that the client shows."""
    session: Constant[SessionConfig] = field(default_factory=SessionConfig)
    """Pacing of plays, but for max_lead_s."""
    timeouts: TimeoutConfig = field(default_factory=TimeoutConfig)
    """Timeouts for clients."""
    admission: AdmissionConfig = field(default_factory=AdmissionConfig)
    """Limits on concurrent connections and plays."""
    overload: OverloadConfig = field(default_factory=OverloadConfig)
    """Load shedding."""
    supervisor: SupervisorConfig = field(default_factory=SupervisorConfig)
    """The worker processes."""
    policy: str = OWN
    """What each client is sent next: a policy of swings-abr, or FILE.py:NAME for one of your own,
    which runs inside the server."""
    max_plays: int = 512
    """Maximum concurrent plays; the server answers a further play with 503."""
    trusted_proxies: str = "127.0.0.0/8,::1/128"
    """Comma-separated networks whose X-Forwarded-For and X-Forwarded-Proto are trusted."""
    keys: Path | None = None
    """Key file; URLs must be signed with one of its keys (see swings-sign). None: open streams."""
    public: bool = False
    """Allow other machines to access streams without signed URLs."""
    tls_cert: Path | None = None
    """Certificate chain in PEM, for HTTPS."""
    tls_key: Path | None = None
    """Private key of the certificate in PEM."""
    log: LogStyle = LogStyle.PLAIN
    """Format of the log, which goes to standard error."""
    log_requests: LogRequests = LogRequests.PLAYS
    """Requests that get a line: plays (and downloads and errors), or all."""
    send_queue_bytes: Constant[int] = 64 * 1024
    """Maximum unsent bytes queued for one play. A longer queue delays each choice of layers."""
    cache_bytes: int = 256 * 1024 * 1024
    """Bytes of objects cached in memory. The current segments of all plays should fit."""
    poll_s: Constant[float] = 0.005
    """Seconds between two checks of the bytes that a client has acknowledged."""
    refresh_s: float = 0.5
    """Seconds between two scans of the streams below the root."""
    live_idle_s: Constant[float] = 60.0
    """Seconds that a play waits for new slices of a live stream before it ends."""
    cors_origin: str = "*"
    """Web origin whose pages may read the streams; empty for none."""

    @property
    def pacing(self) -> SessionConfig:
        """Of a play."""
        return replace(self.session, max_lead_s=self.max_lead_s)

    def __post_init__(self) -> None:
        for name in ("max_plays", "send_queue_bytes", "poll_s", "refresh_s", "live_idle_s"):
            if not getattr(self, name) > 0:
                raise InvalidError(f"{name} is {getattr(self, name)}; it must be positive")
        if self.cache_bytes < 0:
            raise InvalidError(f"cache_bytes is {self.cache_bytes}; it must not be negative")
        if any(not 0x20 < ord(c) < 0x7F for c in self.cors_origin):
            raise InvalidError("cors_origin is not a web origin; give *, an origin or nothing")
        if (self.tls_cert is None) != (self.tls_key is None):
            raise InvalidError("tls_cert and tls_key go together; give both or neither")
        parse_proxies(self.trusted_proxies)
        check_policy(self.policy)
