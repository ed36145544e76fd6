"""What a client says that it has received, in bytes and times of the sender.

Behind a proxy the kernel acknowledges what the proxy took, which may be megabytes more than the
client has. The client's own word is the measure then: when it had how much of the body.

Rule: no clock and no sockets. Whatever a client says, the bytes do not exceed what was sent, and
the times neither go back nor lie in the future.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

REPORT_S = 0.1
"""Time between two reports of a client that the sender measures by them, seconds."""

MOST_BEHIND_BYTES = 256 * 1024
"""Where a client has received so much less than was acknowledged, something stands in between that
does not say so: a tunnel, or a proxy without X-Forwarded-For."""


class Receipts:
    """Of one play."""

    def __init__(self) -> None:
        self.start_bytes = 0
        """Bytes of the body before those of the session."""
        self.came_bytes = 0.0
        """Bytes of the session that have come."""
        self._came_s = -math.inf
        self._offset_s = math.inf
        """The least difference between the sender's clock and the client's, with the time of a
        report in it."""

    def take(
        self, points: Iterable[tuple[int, int]], sent_bytes: float, now_s: float
    ) -> list[tuple[float, float]]:
        """When the client had how many bytes of the session, oldest first.

        points: (milliseconds of any clock, bytes of the body) as they came in a report. sent_bytes:
        of the session.
        """
        points = sorted(points)
        if not points:
            return []
        self._offset_s = min(self._offset_s, now_s - points[-1][0] / 1e3)
        found = []
        for at_ms, body_bytes in points:
            came_bytes = min(body_bytes - self.start_bytes, sent_bytes)
            if came_bytes <= self.came_bytes:
                continue
            self.came_bytes = came_bytes
            self._came_s = max(self._came_s, min(now_s, at_ms / 1e3 + self._offset_s))
            found.append((self._came_s, came_bytes))
        return found
