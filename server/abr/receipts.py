"""What a client says that it has received, in bytes and times of the sender.

Behind a proxy the kernel acknowledges what the proxy took, which may be megabytes more than the
client has. The client's own word is the measure then: when it had how much of the body.

Rule: no clock and no sockets. Whatever a client says, the bytes do not exceed what was sent, and
the times neither go back nor lie in the future.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable

REPORT_S = 0.1
"""Time between two reports of a client that the sender measures by them, seconds."""

MOST_BEHIND_BYTES = 256 * 1024
"""Where a client has received so much less than was acknowledged, something stands in between that
does not say so: a tunnel, or a proxy without X-Forwarded-For."""


class Receipts:
    """Of one play."""

    def __init__(self) -> None:
        self._sent: deque[tuple[float, float]] = deque()
        """Where each piece that has not come whole ends, in bytes of the body as the client counts
        it, without its content coding, and of the session."""
        self._body_bytes = 0.0  # of what was sent
        self._session_bytes = 0.0
        self._from = (0.0, 0.0)  # where the first of `_sent` begins
        self.came_bytes = 0.0
        """Bytes of the session that have come."""
        self._came_s = -math.inf
        self._offset_s = math.inf
        """The least difference between the sender's clock and the client's, with the time of a
        report in it."""

    def sent(self, body_bytes: float, session_bytes: float) -> None:
        """A piece went out; session_bytes: what the session counts of it."""
        self._body_bytes += body_bytes
        self._session_bytes += session_bytes
        self._sent.append((self._body_bytes, self._session_bytes))

    def take(self, points: Iterable[tuple[int, int]], now_s: float) -> list[tuple[float, float]]:
        """When the client had how many bytes of the session, oldest first.

        points: (milliseconds of any clock, bytes of the body) as they came in a report.
        """
        points = sorted(points)
        if not points:
            return []
        self._offset_s = min(self._offset_s, now_s - points[-1][0] / 1e3)
        found = []
        for at_ms, body_bytes in points:
            came_bytes = self._of_session(body_bytes)
            if came_bytes <= self.came_bytes:
                continue
            self.came_bytes = came_bytes
            self._came_s = max(self._came_s, min(now_s, at_ms / 1e3 + self._offset_s))
            found.append((self._came_s, came_bytes))
        return found

    def _of_session(self, body_bytes: float) -> float:
        while self._sent and self._sent[0][0] <= body_bytes:
            self._from = self._sent.popleft()
        if not self._sent:
            return self._session_bytes
        (from_body, from_session), (end_body, end_session) = self._from, self._sent[0]
        if body_bytes <= from_body:
            return from_session
        share = (body_bytes - from_body) / (end_body - from_body)
        return from_session + share * (end_session - from_session)
