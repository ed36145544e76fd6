"""The plays that run, by tokens that only their clients know, and what is remembered of others.

Rule: no clock and no sockets. Whatever clients say, nothing here grows: of each play only its
newest news is kept, and of those that are over the newest `max_ended`, for a while.
"""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass
from enum import StrEnum

from server.abr.standing import Standing


class NewsOutcome(StrEnum):
    """What became of news about a client."""

    TAKEN = "taken"
    REPLACED = "replaced"
    """It took the place of older news, at which the play had not looked yet."""
    REFUSED = "refused"
    """It made no sense."""
    UNKNOWN = "unknown"
    """There is no such play, or there is not any more."""


@dataclass(slots=True)
class RegisteredPlay:
    """A play that runs."""

    stream: str
    rate_bps: float | None = None
    """The newest estimate of its client's throughput."""
    news: Standing | None = None
    """How its client stands, if it has told that since the last `take_news`."""

    def take_news(self) -> Standing | None:
        news, self.news = self.news, None
        return news


class PlayRegister:
    """Those plays. The bound on how many run is somebody else's."""

    def __init__(self, max_ended: int, keep_s: float) -> None:
        """max_ended: plays remembered when they are over. keep_s: for how long, seconds."""
        self._max_ended = max_ended
        self._keep_s = keep_s
        self._running: dict[str, RegisteredPlay] = {}
        self._ended: OrderedDict[str, tuple[float, float]] = OrderedDict()  # rate, when it ended

    def __len__(self) -> int:
        """Plays that run."""
        return len(self._running)

    def begin(self, token: str, stream: str) -> RegisteredPlay:
        """Enters a play of `stream`."""
        self._running[token] = entry = RegisteredPlay(stream)
        return entry

    def end(self, token: str, now_s: float) -> None:
        """Takes a play out; the last estimate of its link stays for a while."""
        rate_bps = self._running.pop(token).rate_bps
        if rate_bps is None:
            return
        self._ended[token] = rate_bps, now_s
        if len(self._ended) > self._max_ended:
            self._ended.popitem(last=False)

    def find(self, token: str, stream: str) -> RegisteredPlay | None:
        """The play of `stream` that runs under this token."""
        entry = self._running.get(token)
        return entry if entry is not None and entry.stream == stream else None

    def tell(self, token: str, stream: str, news: Standing) -> NewsOutcome:
        """Keeps `news` until the play looks at it, or newer news comes."""
        entry = self.find(token, stream)
        if entry is None:
            return NewsOutcome.UNKNOWN
        outcome = NewsOutcome.TAKEN if entry.news is None else NewsOutcome.REPLACED
        entry.news = news
        return outcome

    def rate_bps(self, token: str, now_s: float) -> float | None:
        """What is known of the link of a play that runs, or that ended not long ago."""
        entry = self._running.get(token)
        if entry is not None:
            return entry.rate_bps
        rate_bps, ended_s = self._ended.get(token, (None, now_s))
        return rate_bps if now_s - ended_s <= self._keep_s else None
