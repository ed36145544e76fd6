"""When an answer brings too little for too long. Pure.

Rule: only what is of use extends the time. Bytes whose use is not known yet, as of half a packet,
extend it by what a very slow link would take for them.
"""

from __future__ import annotations

LEAST_BYTES_PER_S = 2000
"""A link that is slower is too slow to play anything."""


class IdleLimit:
    """The time that an answer may go on without anything of use."""

    def __init__(self, idle_s: float, now_s: float) -> None:
        self._idle_s = idle_s
        self._since_s = now_s
        self.num_bytes = 0
        """Bytes that came since something of use did."""
        self._open_bytes = 0
        """Bytes among them whose use is not known yet."""

    def useful(self, now_s: float) -> None:
        """Something of use came, or nothing was wanted until now."""
        self._since_s = now_s
        self.num_bytes = self._open_bytes = 0

    def received(self, num_bytes: int) -> None:
        self.num_bytes += num_bytes
        self._open_bytes += num_bytes

    def judged(self) -> None:
        """The use of what came is known; where it had some, `useful` is called as well."""
        self._open_bytes = 0

    def left_s(self, now_s: float) -> float:
        """Seconds until it is over, above 0; 0 when it is."""
        end_s = self._since_s + self._idle_s + self._open_bytes / LEAST_BYTES_PER_S
        return max(0.0, end_s - now_s)

    def reason(self, now_s: float) -> str:
        """Why it is over."""
        seconds = f"{now_s - self._since_s:.0f} s"
        if not self.num_bytes:
            return f"no bytes arrived for {seconds}"
        return f"{self.num_bytes} bytes arrived in {seconds}, but no usable data"
