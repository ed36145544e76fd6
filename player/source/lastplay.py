"""What a server said of a play and of its client's link: the next play is asked for with it."""

from __future__ import annotations

from dataclasses import dataclass

from server.abr.standing import PLAY_HEADER, RATE_HEADER


@dataclass(frozen=True, slots=True)
class LastPlay:
    """One play."""

    token: str = ""
    """What the server called it; empty where it gave no name."""
    rate_bps: float | None = None
    """What it took the link to carry, bits per second, when it last said so: a server that does
    not know the play, as it was started again since, goes by this."""

    def headers(self) -> dict[str, str]:
        """For the request of the next play."""
        headers = {PLAY_HEADER: self.token} if self.token else {}
        if self.rate_bps is not None:
            headers[RATE_HEADER] = str(round(self.rate_bps))
        return headers


NO_PLAY = LastPlay()
