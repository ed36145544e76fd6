"""The running plays, by tokens that only their clients know, and those that ended lately.

Rule: no clock and no sockets. Memory is bounded whatever clients send: each play keeps only its
newest status report, and only the newest ended plays are remembered.
"""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass
from enum import StrEnum

from server.abr.clientstatus import ClientStatus


class StatusOutcome(StrEnum):
    """The outcome of a client's status report."""

    TAKEN = "taken"
    REPLACED = "replaced"
    """It replaced an older report that the play had not read yet."""
    REFUSED = "refused"
    """It was invalid."""
    UNKNOWN = "unknown"
    """The play does not exist, or has ended."""


class Continuation(StrEnum):
    """Whether the token of a play lets another one continue it."""

    ALLOWED = "allowed"
    RUNNING = "running"
    """Not yet: the play still runs."""
    REFUSED = "refused"


CONTINUE_S = 300.0
"""Time after the end of a play within which its token lets another one continue it, seconds."""

RATE_S = 60.0
"""Time for which the rate of an ended play is told to a client that returns, seconds."""

MAX_ENDED = 4096
"""Ended plays that are remembered."""


@dataclass(slots=True)
class RegisteredPlay:
    """A play that runs."""

    stream: str
    rate_bps: float | None = None
    """The newest estimate of its client's throughput."""
    report_s: float = 0.0
    """The time after which the next report is wanted, where the play goes by them."""
    status: ClientStatus | None = None
    """Its client's status, if reported since the last `pop_status`."""

    def pop_status(self) -> ClientStatus | None:
        status, self.status = self.status, None
        return status


@dataclass(slots=True)
class _EndedPlay:
    ended_s: float
    rate_bps: float | None = None
    is_continued: bool = False


class PlayRegister:
    """The running plays and those that ended lately. The limit on running plays is enforced
    elsewhere (`operate.admission`)."""

    def __init__(self) -> None:
        self._running: dict[str, RegisteredPlay] = {}
        self._ended: OrderedDict[str, _EndedPlay] = OrderedDict()

    def __len__(self) -> int:
        """Plays that run."""
        return len(self._running)

    def begin(self, token: str, stream: str) -> RegisteredPlay:
        """Enters a play of `stream`."""
        self._running[token] = entry = RegisteredPlay(stream)
        return entry

    def end(self, token: str, now_s: float) -> None:
        """Takes a play out; the last estimate of its link stays for a while."""
        self._remember(token, _EndedPlay(now_s, self._running.pop(token).rate_bps))

    def _remember(self, token: str, ended: _EndedPlay) -> None:
        self._ended[token] = ended
        if len(self._ended) > MAX_ENDED:
            self._ended.popitem(last=False)

    def continue_play(self, token: str, now_s: float, is_lost: bool) -> Continuation:
        """Whether a new play may continue that of `token`: once, within CONTINUE_S of its end.

        is_lost: whether the worker that ran the play has died, so that nothing is known of it.
        """
        if token in self._running:
            return Continuation.RUNNING
        if is_lost and token not in self._ended:
            self._remember(token, _EndedPlay(now_s))
        ended = self._ended.get(token)
        if ended is None or ended.is_continued or now_s - ended.ended_s > CONTINUE_S:
            return Continuation.REFUSED
        ended.is_continued = True
        return Continuation.ALLOWED

    def find(self, token: str, stream: str) -> RegisteredPlay | None:
        """The play of `stream` that runs under this token."""
        entry = self._running.get(token)
        return entry if entry is not None and entry.stream == stream else None

    def report(self, token: str, stream: str, status: ClientStatus) -> StatusOutcome:
        """Keeps `status` until the play reads it, or a newer report replaces it."""
        entry = self.find(token, stream)
        if entry is None:
            return StatusOutcome.UNKNOWN
        outcome = StatusOutcome.TAKEN if entry.status is None else StatusOutcome.REPLACED
        entry.status = status
        return outcome

    def rate_bps(self, token: str, now_s: float) -> float | None:
        """The estimated rate of a play that runs or ended at most RATE_S ago; None if unknown."""
        if token in self._running:
            return self._running[token].rate_bps
        ended = self._ended.get(token)
        return ended.rate_bps if ended is not None and now_s - ended.ended_s <= RATE_S else None
